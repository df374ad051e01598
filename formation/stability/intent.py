"""Make an operator's request, check it, and refuse it with a reason before any robot moves.

The checks are pure. The leader, which knows the present shape, and a client, which does not, use the same.
"""

from __future__ import annotations

import math
import reprlib
import secrets
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple, get_args

import numpy as np
from pydantic import ValidationError

from formation.control.arrays import ComplexArray
from formation.mission.model import Mission
from formation.mission.route import Circle, Leg, Route, Straight
from formation.protocol.json_message import encode
from formation.protocol.order import Tuned
from formation.protocol.request import MAX_REQUEST_BYTES, TAKES, Do, OperatorRequest
from formation.slots.geofence import Geofence
from formation.slots.shape import PlacedShape
from formation.stability import spectrum, tuning

TRANSITION_SAMPLES = 33
"""Number of samples of a straight transition from one shape to another."""
SLOT_SPEED_SHARE = 0.7
"""Share for moving slots of the difference between a follower's `max_speed` and the leader's speed."""
MIN_TIME_IN_BOUNDS = 1.0
"""Time in which a route must not leave the bounds [s]."""
MAX_SCALE = 1e3
"""Greatest scale of an order."""


class BadOrder(ValueError):  # noqa: N818 - it is the order that is bad
    """An order is unknown, or a field of it has no legal value; the text names the legal ones."""


def request_for(mission: Mission, do: str, **what: Any) -> OperatorRequest:
    """A request with its own id. Raises BadOrder, or ValueError for one that this mission cannot do.

    `what` are its fields, see `formation.protocol.request.TAKES`, of any type. The leader may refuse more, as
    it knows the figure.
    """
    legal = [one for one in get_args(Do) if one not in {"query", "drive"}]
    if do not in legal:
        raise BadOrder(f"{do!r}: must be one of {', '.join(legal)}")
    what, takes = {name: value for name, value in what.items() if value is not None}, TAKES.get(do, ())
    for name in what:
        if name not in takes:
            raise BadOrder(f"{do}: takes no {name}")
    if do == "shape" and not what.get("shape"):
        raise BadOrder(f"shape: must be one of {', '.join(mission.shapes)}")
    try:
        request = OperatorRequest.model_validate(
            {"do": do, **what, "id": secrets.token_hex(8), "mission": mission.tag}
        )
    except ValidationError as error:
        raise BadOrder(f"{do}: {_plain(error)}") from None
    if why := refusal(mission, request):
        raise ValueError(why)
    if len(encode(request)) > MAX_REQUEST_BYTES:
        raise BadOrder(f"{do}: too long, at most {MAX_REQUEST_BYTES} bytes are sent")
    return request


def refusal(
    mission: Mission,
    request: OperatorRequest,
    placed_shape: PlacedShape | None = None,
    transition: Sequence[PlacedShape] = (),
    legs: Sequence[Leg] | None = None,
    gains: Tuned | None = None,
    place: complex | None = None,
) -> str | None:
    """Why `request` cannot be done, in one sentence with the legal values; None if it can.

    `placed_shape` is the wanted one, its rotation as an order has it (with ``turning`` from
    the leader's heading); None if unknown, and then only what no shape makes possible is refused.
    `transition` leads from the present shape; by default it is straight, from `placed_shape`. `legs` is the
    leader's route, by default the mission's. `gains` are those that `tuned` gives, or for a speed or a route
    those in force; None if unknown.
    `place` is the leader's position [m; world frame]; None if unknown, and then the bounds are not
    checked.
    """
    if request.shape is not None and request.shape not in mission.shapes:
        return f"shape {request.shape!r}: must be one of {', '.join(mission.shapes)}"
    if request.do == "tune":
        return _untunable(mission, request, gains)
    if request.speed is not None:
        return _too_fast(mission, request.speed, "speed", gains)
    if request.legs is not None:
        why = _route(mission, request.legs, gains)
        return why if why or placed_shape is None else swings_too_fast(mission, placed_shape, request.legs)
    wanted = None if placed_shape is None else ordered_shape(request, placed_shape)
    if placed_shape is None or wanted is None:
        return _small_in_any_shape(mission, request.factor) if placed_shape is None else None
    transition = transition or straight(placed_shape, wanted)
    return (
        _touches(mission, wanted)
        or (None if place is None else Geofence(mission).refusal(transition, place))
        or _touches_during(mission, transition)
        or swings_too_fast(mission, wanted, mission.route if legs is None else legs)
    )


def leaves(
    fence: Geofence, route: Route, placed_shapes: Iterable[PlacedShape], heading: complex, since: float = 0.0
) -> tuple[str | None, str]:
    """Why a route cannot be taken with these shapes, and a note on one that can.

    A route that ends must end inside the bounds. An endless one is taken as far as they reach, but not if
    it would leave them within `MIN_TIME_IN_BOUNDS`. With ``turning`` rotations are from the leader's heading,
    which was `heading` before `since` [s].
    """
    exits = [found for one in placed_shapes if (found := fence.exit(route, one, since, heading)) is not None]
    if not exits:
        return None, ""
    first = min(exits)
    after = first.time - since
    if math.isfinite(route.total) or first.time < route.last_change or after < MIN_TIME_IN_BOUNDS:
        return f"out of bounds after {after:.3g} s: {first.breach.words}", ""
    return None, f"stops at the bounds in {after:.3g} s, where {first.words}"


def ordered_shape(request: OperatorRequest, placed_shape: PlacedShape) -> PlacedShape | None:
    """The shape that `request` makes of the wanted `placed_shape`; None if it changes none."""
    if request.do == "shape" and request.shape is not None:
        return placed_shape._replace(mix=((request.shape, 1.0),))
    if request.do == "rotate" and request.degrees is not None:
        return placed_shape._replace(rotation=math.remainder(math.radians(request.degrees), math.tau))
    if request.do == "scale" and request.factor is not None:
        return placed_shape._replace(scale=request.factor)
    return None


def straight(begin: PlacedShape, end: PlacedShape) -> list[PlacedShape]:
    """Shapes on the straight transition, both ends included; turned the shorter way round."""
    first, last = dict(begin.mix), dict(end.mix)
    turn = math.remainder(end.rotation - begin.rotation, math.tau)
    ways = []
    for part in (k / (TRANSITION_SAMPLES - 1) for k in range(TRANSITION_SAMPLES)):
        mix = tuple(
            (name, (1.0 - part) * first.get(name, 0.0) + part * last.get(name, 0.0))
            for name in {**first, **last}
        )
        scale = (1.0 - part) * begin.scale + part * end.scale
        ways.append(PlacedShape(mix, begin.rotation + part * turn, scale))
    return ways


def tuned(request: OperatorRequest, before: Tuned) -> Tuned:
    """The gains that ``tune`` makes of the wanted ones, rounded to six digits."""
    requested = {name: getattr(request, name) for name in TAKES["tune"]}
    return before.model_copy(
        update={name: float(f"{value:.6g}") for name, value in requested.items() if value is not None}
    )


def _plain(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(reprlib.repr(part).strip("'") for part in first["loc"])  # keys may be any text
    if first["type"] == "missing":
        return f"{where}: must be given"
    message = first["msg"].replace("Input should be", "must be").replace("a valid tuple", "a list")
    return f"{where} = {reprlib.repr(first['input'])}: {message}" if where else message


def _untunable(mission: Mission, request: OperatorRequest, gains: Tuned | None) -> str | None:
    """Why gains cannot be tuned; None also if one is requested and the other unknown."""
    requested = tuple(name for name in TAKES["tune"] if getattr(request, name) is not None)
    if gains is None and request.k_p is not None and request.k_i is not None:
        gains = tuned(request, Tuned(k_p=request.k_p, k_i=request.k_i))
    return None if gains is None else tuning.refusal(mission, gains, requested)


def _route(mission: Mission, legs: Sequence[Leg], gains: Tuned | None) -> str | None:
    for number, leg in enumerate(legs):
        where = f"route.{number}"
        if isinstance(leg, (Straight, Circle)) and leg.duration is None and number < len(legs) - 1:
            return f"{where}.duration: only the last leg may go without a duration [s]"
        why = _too_fast(mission, leg.speed, f"{where}.speed", gains)
        if why is None and isinstance(leg, Circle):
            why = _too_tight(mission, leg, where)
        if why is not None:
            return why
    return None


def _too_fast(mission: Mission, speed: float, what: str, gains: Tuned | None) -> str | None:
    slowest = min(mission.followers, key=lambda name: mission.robots[name].max_speed)
    limit = mission.robots[slowest].max_speed
    if speed >= limit:
        return f"{what} = {speed:g} m/s: must be below {slowest}'s max_speed of {limit:g} m/s"
    first, most = spectrum.greatest_leader_speed(mission, (gains or mission.gains).k_p)
    if speed < most:
        return None
    why = f"beyond that {first} turns too far between two commands, at {mission.robots[first].rate:g} Hz"
    return f"{what} = {speed:g} m/s: must be below {most:.3g} m/s; {why}"


def _too_tight(mission: Mission, circle: Circle, where: str) -> str | None:
    """In formation every control point circles as the leader does: ω = v/r, and L ω = v sin φ needs L < r."""
    robots = mission.robots
    slowest = min(mission.followers, key=lambda name: robots[name].max_turn_rate)
    longest = max(mission.followers, key=lambda name: robots[name].control_point_offset)
    radius = max(robots[longest].control_point_offset, circle.speed / robots[slowest].max_turn_rate)
    if circle.radius > robots[longest].control_point_offset and circle.radius >= radius:
        return None
    who = longest if radius == robots[longest].control_point_offset else slowest
    return f"{where}.radius = {circle.radius:g} m: too tight for {who}; must be above {radius:.3g} m"


def swings_too_fast(mission: Mission, placed_shape: PlacedShape, legs: Iterable[Leg]) -> str | None:
    """Why a shape, turned as from the leader's heading, cannot turn with it along `legs`; None if it can.

    On a circle a slot at z from the leader moves at |ω z| beside it. Without ``turning`` none does.
    """
    if not mission.turning:
        return None
    for leg in legs:
        if not isinstance(leg, Circle):
            continue
        for name in mission.followers:
            swing = leg.speed / leg.radius * abs(placed_shape.slot(mission, name))
            most = SLOT_SPEED_SHARE * (mission.robots[name].max_speed - leg.speed)
            if swing > most:
                return (
                    f"{name}'s slot would swing at {swing:.3g} m/s on the circle of {leg.radius:g} m; "
                    f"must be at most {max(most, 0.0):.3g} m/s"
                )
    return None


class _Pair(NamedTuple):
    """The two robots with the closest slots, relative to their radii."""

    first: str
    second: str
    distance: float
    """[m]"""
    radii: float
    """Of both [m]."""

    @property
    def need(self) -> float:
        """Factor by which the shape must grow so that they do not touch."""
        return self.radii / self.distance if self.distance > 0.0 else math.inf

    def touch(self, how: str, scale: float) -> str:
        larger = math.ceil(scale * self.need * 1e3 - 1e-6) / 1e3 if math.isfinite(self.need) else math.inf
        mend = f"; scale must be above {larger:g}" if 0.0 < larger < MAX_SCALE else ""
        return (
            f"{self.first} and {self.second} would touch{how}: {self.distance:.3g} m apart, "
            f"must be over {self.radii:g} m{mend}"
        )


def _touches(mission: Mission, placed_shape: PlacedShape) -> str | None:
    """In formation headings agree, so centres are as far apart as slots. The virtual leader has no body."""
    closest = _closest(mission, placed_shape)
    return None if closest is None or closest.need < 1.0 else closest.touch("", placed_shape.scale)


def _touches_during(mission: Mission, transition: Sequence[PlacedShape]) -> str | None:
    """Why slots touch during a transition; those that touch at its start may move apart."""
    first = _closest(mission, transition[0])
    before = 1.0 if first is None else max(1.0, first.need)
    worst: tuple[_Pair, PlacedShape] | None = None
    for placed_shape, after in pairwise(transition):
        closest = _closest(mission, placed_shape, after)
        if closest is None or closest == first or closest.need < before:
            continue
        if worst is None or closest.need > worst[0].need:
            worst = closest, placed_shape
    return None if worst is None else worst[0].touch(" on the way", worst[1].scale)


def _closest(mission: Mission, placed_shape: PlacedShape, after: PlacedShape | None = None) -> _Pair | None:
    """The pair with the closest slots, relative to their radii; None with fewer than two followers.

    With a shape `after` it, on the straight transition to that.
    """
    names = mission.followers
    if len(names) < 2:
        return None
    radii = np.array([mission.robots[name].radius for name in names])
    between, both = _between(mission, placed_shape), radii[:, None] + radii[None, :]
    if after is not None:
        way = _between(mission, after) - between
        square = np.maximum(np.abs(way) ** 2, np.finfo(float).tiny)
        part = np.clip(-(between * way.conj()).real / square, 0.0, 1.0)
        between = between + part * way
    distances = np.abs(between)
    gaps = distances / both + np.diag(np.full(len(names), np.inf))
    i, j = sorted(int(index) for index in np.unravel_index(np.argmin(gaps), gaps.shape))
    return _Pair(names[i], names[j], round(float(distances[i, j]), 9), float(both[i, j]))


def _between(mission: Mission, placed_shape: PlacedShape) -> ComplexArray:
    """From each follower's slot to each other's, not turned, which keeps distances [m]; shape (n, n)."""
    drawn = placed_shape._replace(rotation=0.0)
    slots: ComplexArray = np.array([drawn.slot(mission, name) for name in mission.followers])
    return slots[:, None] - slots[None, :]


def _small_in_any_shape(mission: Mission, factor: float | None) -> str | None:
    if factor is None:
        return None
    whys = [_touches(mission, PlacedShape(((shape, 1.0),), 0.0, factor)) for shape in mission.shapes]
    return whys[0] if all(whys) else None
