"""What a mission requires, compared with its robots' limits and its bounds; each check yields sentences.

A problem is a fault that no tuning of the law can correct; a warning is one that allows driving, but not
well.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from formation.mission.graph import Graph
from formation.mission.model import Mission
from formation.mission.route import Circle, Route
from formation.mission.rules import too_close
from formation.simulation.body import Body
from formation.slots.geofence import HORIZON_TIME, Geofence
from formation.slots.shape import PlacedShape
from formation.stability.intent import swings_too_fast

USUAL: tuple[tuple[str, float, str], ...] = (
    ("control_point_offset", 1.0, "m"),
    ("radius", 1.0, "m"),
    ("max_speed", 5.0, "m/s"),
    ("max_turn_rate", 20.0, "rad/s"),
)
"""Greatest usual value of a robot's keys: more may be of another unit, millimetres or degrees."""
LEADER_SPEED_SHARE = 0.8
"""Share of a follower's top speed that the leader may use without a warning."""


def problems(mission: Mission) -> Iterator[str]:
    """Faults with which the mission cannot work."""
    yield from _too_fast(mission)
    yield from _too_tight(mission)
    yield from _slots_touch(mission)
    for shape in mission.shapes:
        why = swings_too_fast(mission, PlacedShape(((shape, 1.0),)), mission.route)
        if why is not None:
            yield f"shapes.{shape}: {why}"


def warnings(mission: Mission) -> Iterator[str]:
    """Faults with which it will not work well."""
    yield from _unusual(mission)
    yield from _little_reserve(mission)
    yield from _weaker_body(mission)
    yield from _waits_for_ever(mission)
    yield from out_of_bounds(mission)


def unreachable(graph: Graph, names: tuple[str, ...]) -> dict[str, str]:
    """Each robot without a path to the leader, and why: the robots that its neighbours lead to."""
    reasons = {}
    for i in graph.unreachable:
        found, waiting = {i}, [i]
        while waiting:
            for j in graph.neighbours[waiting.pop()]:
                if j not in found:
                    found.add(j)
                    waiting.append(j)
        others = ", ".join(names[j] for j in sorted(found - {i}))
        reasons[names[i]] = f"its neighbours lead only to {others}" if others else "it measures no robot"
    return reasons


def _limits(mission: Mission, name: str) -> tuple[float, float]:
    """Limits of a follower, by the mission and by the simulated robot [m/s], [rad/s]."""
    robot, body = mission.robots[name], Body.of(mission.simulated_robot)
    return min(robot.max_speed, body.max_speed), min(robot.max_turn_rate, body.max_turn_rate)


def _too_fast(mission: Mission) -> Iterator[str]:
    for number, leg in enumerate(mission.route):
        slow = [name for name in mission.followers if leg.speed >= _limits(mission, name)[0]]
        if slow:
            limit = min(_limits(mission, name)[0] for name in slow)
            yield (
                f"route.{number}.speed = {leg.speed:g} m/s: {_list(slow)} cannot keep up; "
                f"must be below {limit:g} m/s"
            )


def _too_tight(mission: Mission) -> Iterator[str]:
    """In formation every control point circles as the leader does: ω = v/r, and L ω = v sin φ needs L < r."""
    for number, leg in enumerate(mission.route):
        if not isinstance(leg, Circle):
            continue
        turn_rate = leg.speed / leg.radius
        slow = [name for name in mission.followers if turn_rate > _limits(mission, name)[1]]
        if slow:
            limit = min(_limits(mission, name)[1] for name in slow)
            yield (
                f"route.{number}: a circle of radius {leg.radius:g} m at {leg.speed:g} m/s turns at "
                f"{turn_rate:.3g} rad/s, faster than {_list(slow)}; must be at most {limit:g} rad/s"
            )
        offsets = {name: mission.robots[name].control_point_offset for name in mission.followers}
        long = [name for name, offset in offsets.items() if offset >= leg.radius]
        if long:
            yield (
                f"route.{number}.radius = {leg.radius:g} m: too tight for the control_point_offset of "
                f"{_list(long)}; must be above {max(offsets.values()):g} m"
            )


def _slots_touch(mission: Mission) -> Iterator[str]:
    """In formation headings agree, so centres are as far apart as slots. The virtual leader has no body."""
    radii = [mission.robots[name].radius for name in mission.followers]
    for shape in mission.shapes:
        for i, j, distance in too_close([mission.slot(name, shape) for name in mission.followers], radii):
            first, second = mission.followers[i], mission.followers[j]
            yield (
                f"shapes.{shape}: the slots of {first} and {second} are {distance:.3g} m apart; "
                f"must be over {radii[i] + radii[j]:g} m (both radii)"
            )


def _unusual(mission: Mission) -> Iterator[str]:
    for key, limit, unit in USUAL:
        over = [name for name in mission.followers if getattr(mission.robots[name], key) > limit]
        if over:
            value = max(getattr(mission.robots[name], key) for name in over)
            usual = f"usual is at most {limit:g} {unit}"
            yield f"{key} of {_list(over)} is {value:g} {unit}, {usual}: check its unit"


def _little_reserve(mission: Mission) -> Iterator[str]:
    fastest = max(leg.speed for leg in mission.route)
    slow = [name for name in mission.followers if _limits(mission, name)[0] > fastest]
    slow = [name for name in slow if fastest > LEADER_SPEED_SHARE * _limits(mission, name)[0]]
    if slow:
        limit = min(_limits(mission, name)[0] for name in slow)
        yield (
            f"the leader drives at {fastest:g} m/s and {_list(slow)} at {limit:g} m/s at most: "
            f"to catch up by a metre takes {1.0 / (limit - fastest):.0f} s"
        )


def _weaker_body(mission: Mission) -> Iterator[str]:
    body = Body.of(mission.simulated_robot)
    for key, limit, unit in (
        ("max_speed", body.max_speed, "m/s"),
        ("max_turn_rate", body.max_turn_rate, "rad/s"),
    ):
        over = [name for name in mission.followers if getattr(mission.robots[name], key) > limit]
        if over and math.isfinite(limit):
            yield (
                f"{key} of {_list(over)} is above the simulated robot's {limit:g} {unit}: "
                "the law does not know when the body saturates; should be at most that"
            )


def _waits_for_ever(mission: Mission) -> Iterator[str]:
    """A leader that waits by positions which drift while the robots are in place by their own sensors."""
    waited = [name for name in mission.followers if name in mission.waited_for]
    robots = mission.robots
    drift = [n for n in waited if (robots[n].measurement, robots[n].localisation) == ("local", "odometry")]
    if drift and mission.cohesion is not None and mission.cohesion.patience is None:
        yield (
            f'cohesion.patience is missing, and {_list(drift)} have measurement = "local": positions they'
            " publish drift with their odometry, so the leader may wait for ever for robots in their places;"
            " set it, for example to 20 (seconds)"
        )


def out_of_bounds(mission: Mission) -> Iterator[str]:
    """A route that ends at the bounds within `HORIZON_TIME`, and shapes refused at the start."""
    fence, route = Geofence(mission), Route.of(mission)
    first = fence.exit(route, PlacedShape.first(mission)._replace(rotation=0.0))
    ends = route.total if math.isfinite(route.total) else HORIZON_TIME
    if first is not None and first.time <= ends:
        yield (
            f"the route leaves the bounds after {first.time:.4g} s, where {first.words}: the leader "
            "stops there; change [[route]], or widen [bounds]"
        )
    start = mission.robots[mission.leader].start.position
    for shape in mission.shapes:
        if shape == mission.first_shape:
            continue
        placed_shape = PlacedShape.first(mission)._replace(mix=((shape, 1.0),))
        worst = fence.breach([placed_shape], start, fence.clearance)
        if worst.excess > 0.0:
            yield f"shape {shape} leaves the bounds at the start, and is refused there: {worst.words}"


def _list(names: list[str]) -> str:
    return ", ".join(names) if len(names) <= 6 else f"{', '.join(names[:5])} and {len(names) - 5} more"
