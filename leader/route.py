"""The route that the leader is on: the mission's, or one that an operator ordered from where it was.

Every order names its route by `id`, and gives the leader's time on it and its place. Routes other than the
mission's are published for the other candidates (`formation.topics.ROUTE`). A new leader that does not know
the route in force stands where the leader was (`NamedRoute.standing`).
"""

from __future__ import annotations

import cmath
import hashlib
import math
from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, StringConstraints, ValidationError

from formation.mission.model import Mission
from formation.mission.route import Arc, Leg, Route
from formation.protocol.order import DRIVEN_ROUTE, MAX_MOTION_SECONDS, Motion, Number, Place, Steady
from formation.protocol.request import Legs
from formation.ros2.messages import Text, decode, encode
from formation.wire import BadMessage

MAX_COORDINATE = 1e6
"""Largest magnitude of a coordinate of a `Place` [m]."""
LOOKAHEAD_TIME = 1.0
"""How far ahead the leader's highest speed is computed [s]."""
LOOKAHEAD_STEPS = 10
"""Number of steps in which the leader's highest speed is sampled."""


class _RouteMessage(BaseModel):
    """A route as JSON."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)
    id: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{12}$")]
    x: Number
    y: Number
    heading: Number
    legs: Legs

    @property
    def name(self) -> str:
        """The route's id: equal for equal routes."""
        body = self.model_dump_json(exclude_none=True, exclude={"id"})
        return hashlib.sha256(body.encode()).hexdigest()[:12]


class NamedRoute(Route):
    """A route with a name."""

    def __init__(
        self,
        name: str,
        legs: Sequence[Leg],
        start: complex,
        heading: complex,
        message: _RouteMessage | None = None,
    ) -> None:
        super().__init__(legs, start, heading)
        self.id = name
        """Empty for the mission's own route."""
        self.legs = tuple(legs)
        """Empty if it stands instead of an unknown route."""
        self._message = message

    @classmethod
    def of(cls, mission: Mission) -> Self:
        """Return the mission's own route."""
        start = mission.robots[mission.leader].start
        return cls("", mission.route, start.position, start.heading)

    @classmethod
    def ordered(cls, legs: Sequence[Leg], start: complex, heading: complex) -> Self:
        """Return the route along `legs` from `start` [m; world frame] with direction `heading` (unit)."""
        place = place_of(start, heading)
        message = _RouteMessage(id="0" * 12, x=place.x, y=place.y, heading=place.heading, legs=tuple(legs))
        return cls._of(message.model_copy(update={"id": message.name}))

    @classmethod
    def standing(cls, name: str, place: Place) -> Self:
        """Return a route that stands at `place`, instead of the unknown route `name`."""
        return cls(name, (), complex(place.x, place.y), cmath.rect(1.0, place.heading))

    @classmethod
    def driven(cls, position: complex, heading: complex, forward: float, turn_rate: float) -> Self:
        """Return the route of a leader that is driven by hand: on at `forward` [m/s] and `turn_rate` [rad/s].

        `position` [m; world frame] and unit `heading` are its own; a negative speed is backwards.
        """
        route = cls(DRIVEN_ROUTE, (), position, heading)
        route.total, route.begins = math.inf, (0.0,)
        route.arcs = (Arc(position, heading, forward, turn_rate, math.inf),)
        return route

    @classmethod
    def read(cls, payload: bytes) -> Self:
        """Return another candidate's route. Raises BadMessage."""
        try:
            message = _RouteMessage.model_validate_json(decode(Text, payload).text)
        except ValidationError as error:
            first = error.errors(include_url=False, include_input=False, include_context=False)[0]
            raise BadMessage(f"route: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
        if message.id != message.name:
            raise BadMessage(f"route: id {message.id} does not match its content")
        return cls._of(message)

    @property
    def payload(self) -> bytes | None:
        """The message for the other candidates; None for the mission's route and an unknown one."""
        return (
            None if self._message is None else encode(Text(self._message.model_dump_json(exclude_none=True)))
        )

    def where(self, time: float) -> complex:
        """Return the leader's position [m; world frame] after `time` on the route [s], as it is published."""
        where = self.position(time)
        return complex(_clipped(where.real), _clipped(where.imag))

    def max_speed(self, since: float, until: float) -> float:
        """Return the leader's highest speed from `since` until `LOOKAHEAD_TIME` after `until` [m/s]."""
        step = (until + LOOKAHEAD_TIME - since) / LOOKAHEAD_STEPS
        return max(abs(self.velocity(since + number * step)) for number in range(LOOKAHEAD_STEPS + 1))

    def place(self, time: float) -> Place:
        """Return the leader's place, as in an order."""
        return place_of(self.where(time), self.heading(time))

    def motion(self, time: float, pace: float) -> Motion | None:
        """Return the leader's velocity after `time` on the route [s] at a share `pace` of its speed.

        None if it stands, and does not start soon.
        """
        now, then = _steady(self, time, pace), None
        change = self.next_change(time)
        until = (change - time) / pace if pace > 0.0 else math.inf
        if until <= MAX_MOTION_SECONDS:
            then = _steady(self, change, pace)
        if then is None and now.after(0.0) == 0j:
            return None
        return Motion(**now.model_dump(), until=0.0 if then is None else round(until, 4), then=then)

    @classmethod
    def _of(cls, message: _RouteMessage) -> Self:
        start, heading = complex(message.x, message.y), cmath.rect(1.0, message.heading)
        return cls(message.id, message.legs, start, heading, message)


def place_of(position: complex, heading: complex) -> Place:
    """Return the place rounded to 0.1 mm and 0.1 mrad."""
    return Place(
        x=round(_clipped(position.real), 4),
        y=round(_clipped(position.imag), 4),
        heading=round(cmath.phase(heading), 4),
    )


def _steady(route: Route, time: float, pace: float) -> Steady:
    velocity = pace * route.velocity(time)
    return Steady(
        x=round(velocity.real, 6),
        y=round(velocity.imag, 6),
        turn_rate=round(pace * route.turn_rate(time), 6),
    )


def _clipped(value: float) -> float:
    return min(max(value, -MAX_COORDINATE), MAX_COORDINATE) if math.isfinite(value) else 0.0
