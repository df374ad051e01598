"""The course that the leader is on: the mission's route, or one that an operator ordered from where it was.

Every order names its course by `id`, and says how long the leader has been on it and where it is. Courses
other than the mission's are told to whoever may have to go on (`formation.topics.COURSE`). Who does not know
the one in force stands where the leader was (`Course.standing`).
"""

from __future__ import annotations

import cmath
import hashlib
import math
from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from formation.legs import Leg, Straight
from formation.mission import Mission
from formation.order import Legs, Number, Place
from formation.ros2.messages import Text, decode, encode
from formation.route import Route
from formation.wire import BadMessage

FARTHEST = 1e6
"""As far from the origin as a `Place` can be [m]."""
AHEAD = 1.0
"""So far ahead it is known how fast the leader will be [s], …"""
LOOKS = 10
"""… by so many looks."""


class _Said(BaseModel):
    """A course as JSON."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)
    id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{12}$")]
    x: Number
    y: Number
    heading: Number
    legs: Legs

    @property
    def name(self) -> str:
        """What it is to be called: equal for equal courses."""
        body = self.model_dump_json(exclude_none=True, exclude={"id"})
        return hashlib.sha256(body.encode()).hexdigest()[:12]


class Course:
    """A route with a name."""

    def __init__(self, name: str, route: Route, said: _Said | None = None, legs: Sequence[Leg] = ()) -> None:
        self.id = name
        """Empty for the mission's own."""
        self.legs = tuple(legs)
        """None while standing."""
        self._route, self._said = route, said

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """The mission's own."""
        return cls("", Route.of(mission), None, mission.route)

    @classmethod
    def ordered(cls, legs: Sequence[Leg], start: complex, heading: complex) -> Self:
        """Along `legs` from `start` [m; world frame], where the leader looks along `heading` (unit)."""
        place = place_of(start, heading)
        said = _Said(id="0" * 12, x=place.x, y=place.y, heading=place.heading, legs=tuple(legs))
        return cls._of(said.model_copy(update={"id": said.name}))

    @classmethod
    def endless(cls, speed: float, degrees: float, start: complex, heading: complex) -> Self:
        """Straight on for ever at `speed` [m/s] in the direction `degrees` [world frame]."""
        return cls.ordered((Straight(speed=speed, heading_deg=degrees),), start, heading)

    @classmethod
    def standing(cls, name: str, place: Place) -> Self:
        """At `place`, in the stead of the course `name`, which is not known here."""
        return cls(name, Route((), complex(place.x, place.y), cmath.rect(1.0, place.heading)))

    @classmethod
    def read(cls, payload: bytes) -> Self:
        """What another candidate told. Raises BadMessage."""
        try:
            said = _Said.model_validate_json(decode(Text, payload).text)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False, include_context=False)[0]
            raise BadMessage(f"Course: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        if said.id != said.name:
            raise BadMessage(f"Course: {said.id} is not the name of what it says")
        return cls._of(said)

    @property
    def known(self) -> bool:
        """Whether it leads anywhere, and not only stands in the stead of one that does."""
        return bool(self.legs)

    @property
    def route(self) -> Route:
        """Where it leads."""
        return self._route

    @property
    def payload(self) -> bytes | None:
        """What others are told of it; None for what they know, or nobody knows."""
        return None if self._said is None else encode(Text(self._said.model_dump_json(exclude_none=True)))

    @property
    def total(self) -> float:
        """How long it takes [s]; infinite if its last leg never ends."""
        return self._route.total

    def position(self, time: float) -> complex:
        """Where the leader is [m; world frame] after `time` on it [s]."""
        where = self._route.position(time)
        return complex(_within(where.real), _within(where.imag))

    def heading(self, time: float) -> complex:
        """Its direction of travel, unit complex [world frame]."""
        return self._route.heading(time)

    def turn_rate(self, time: float) -> float:
        """How fast that turns [rad/s]."""
        return self._route.turn_rate(time)

    def velocity(self, time: float) -> complex:
        """The leader's velocity [m/s; world frame]."""
        return self._route.velocity(time)

    def fastest(self, since: float, until: float) -> float:
        """The leader's highest speed from `since` until `AHEAD` after `until` [m/s]."""
        step = (until + AHEAD - since) / LOOKS
        return max(abs(self._route.velocity(since + number * step)) for number in range(LOOKS + 1))

    def place(self, time: float) -> Place:
        """Where it is, as an order says it."""
        return place_of(self.position(time), self.heading(time))

    @classmethod
    def _of(cls, said: _Said) -> Self:
        start, heading = complex(said.x, said.y), cmath.rect(1.0, said.heading)
        return cls(said.id, Route(said.legs, start, heading), said, said.legs)


def place_of(position: complex, heading: complex) -> Place:
    """A tenth of a millimetre, and of a milliradian, is near enough to go on from."""
    return Place(
        x=round(_within(position.real), 4),
        y=round(_within(position.imag), 4),
        heading=round(cmath.phase(heading), 4),
    )


def _within(value: float) -> float:
    return min(max(value, -FARTHEST), FARTHEST) if math.isfinite(value) else 0.0
