"""What makes a mission legal beyond its types; each rule yields what breaks it, most basic rule first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic_core import PydanticCustomError

from formation.ros2.ros_names import RosNames, clash, is_namespace

if TYPE_CHECKING:
    from formation.mission.model import Mission

VISITORS = ("monitor", "operator")
"""What the processes are called that belong to no robot."""

MIN_POSITIONS = 4
"""So many positions a follower tells in a takeover at least, or a leader's lease ends between two of them."""


class Violation(NamedTuple):
    """One thing that is not legal: where, what stands there, and what may stand there."""

    key: str
    value: Any
    legal: str


def enforce(mission: Mission) -> None:
    """Raise for the first violation, as an error that pydantic passes to the caller."""
    for rule in RULES:
        for broken in rule(mission):
            raise PydanticCustomError("mission", "{legal}", broken._asdict())


def leader_is_a_robot(mission: Mission) -> Iterator[Violation]:
    """The leader is one of the robots and has no neighbours."""
    if mission.leader not in mission.robots:
        yield Violation("leader", mission.leader, f"must be one of the robots: {_list(mission.robots)}")
        return
    for key in ("neighbours", "fallback_neighbours"):
        if others := getattr(mission.robots[mission.leader], key):
            legal = "must be empty: the leader follows its route, not a neighbour"
            yield Violation(f"robots.{mission.leader}.{key}", list(others), legal)


def neighbours_exist(mission: Mission) -> Iterator[Violation]:
    """Each neighbour and fallback neighbour is another robot of the mission, listed once."""
    for name, robot in mission.robots.items():
        for key in ("neighbours", "fallback_neighbours"):
            others = getattr(robot, key)
            for position, other in enumerate(others):
                problem = None
                if other == name:
                    problem = f"a robot cannot be its own neighbour; choose from {_others(mission, name)}"
                elif other not in mission.robots:
                    problem = f"unknown robot; choose from {_others(mission, name)}"
                elif other in others[:position]:
                    problem = "listed twice; each neighbour counts once"
                elif key != "neighbours" and other in robot.neighbours:
                    problem = "is a neighbour already; fallback_neighbours are for when all of those are lost"
                if problem is not None:
                    yield Violation(f"robots.{name}.{key}", other, problem)


def avoided_have_bodies(mission: Mission) -> Iterator[Violation]:
    """Every robot in `avoid` is a follower: the leader has no body."""
    for name in mission.followers:
        avoid = mission.robots[name].avoid
        # what stands under [robot] is of every robot, and each may stand in the others' list
        by_default = avoid == mission.robot.avoid
        key = "robot.avoid" if by_default else f"robots.{name}.avoid"
        for other in () if avoid == "all" else avoid:
            if other in mission.robots and other != mission.leader:
                continue
            others = [one for one in mission.followers if by_default or one != name]
            legal = (
                f'choose from {", ".join(others)}, or avoid = "all"' if others else 'must be avoid = "all"'
            )
            problem = "has no body, for it leads" if other == mission.leader else "unknown robot"
            yield Violation(key, other, f"{problem}; {legal}")


def tree_from_the_leader(mission: Mission) -> Iterator[Violation]:
    """Every follower has a path of neighbours to the leader (Assumption 1 of the paper)."""
    lost = [mission.names[i] for i in mission.graph.unreachable]
    if lost:
        yield Violation(
            f"robots.{lost[0]}.neighbours",
            list(mission.robots[lost[0]].neighbours),
            f"no path of neighbours leads from {_list(lost)} to the leader {mission.leader!r}; all need one",
        )


def shapes_are_complete(mission: Mission) -> Iterator[Violation]:
    """Every shape has one slot for each follower, and no others; `shape` names one of the shapes."""
    followers = set(mission.followers)
    for shape, slots in mission.shapes.items():
        for name in slots:
            if name not in followers:
                legal = f"must be a follower: {_list(mission.followers)}"
                yield Violation(f"shapes.{shape}.{name}", list(slots[name]), legal)
        missing = [name for name in mission.followers if name not in slots]
        if missing:
            legal = f"has no slot for {_list(missing)}; every follower needs one"
            yield Violation(f"shapes.{shape}", _list(slots), legal)
    if mission.shape is not None and mission.shape not in mission.shapes:
        yield Violation("shape", mission.shape, f"must be one of the shapes: {_list(mission.shapes)}")


def leader_slower_than_followers(mission: Mission) -> Iterator[Violation]:
    """The speed of every leg is below the `max_speed` of every follower."""
    slowest = min(mission.followers, key=lambda name: mission.robots[name].max_speed)
    limit = mission.robots[slowest].max_speed
    for number, leg in enumerate(mission.route):
        if leg.speed >= limit:
            legal = f"must be below {slowest}'s max_speed of {limit:g} m/s"
            yield Violation(f"route.{number}.speed", leg.speed, legal)


def only_the_last_leg_is_endless(mission: Mission) -> Iterator[Violation]:
    """Every leg except the last has an end: a straight or circle leg needs a `duration`."""
    for number, leg in enumerate(mission.route[:-1]):
        if getattr(leg, "duration", 0.0) is None:
            legal = "only the last leg may go without a duration [s]"
            yield Violation(f"route.{number}.duration", None, legal)


def starts_do_not_touch(mission: Mission) -> Iterator[Violation]:
    """Any two followers start further apart than the sum of their radii."""
    bodies = [mission.robots[name] for name in mission.followers]
    radii = [body.radius for body in bodies]
    for i, j, distance in too_close([body.start.position for body in bodies], radii):
        first, second = mission.followers[i], mission.followers[j]
        yield Violation(
            f"robots.{second}.start",
            f"{{x = {bodies[j].start.x:g}, y = {bodies[j].start.y:g}}}",
            f"must be over {radii[i] + radii[j]:g} m (both radii) from {first}'s start; "
            f"it is {distance:.3g} m away",
        )


def standbys_have_names_of_their_own(mission: Mission) -> Iterator[Violation]:
    """A standby has a name of its own: not a robot's, not `monitor` and not `operator`."""
    for name in mission.standbys:
        if name in mission.robots:
            legal = "is a robot's name; a standby is no robot and has its own"
            yield Violation(f"standbys.{name}", name, legal)
        if name in VISITORS:
            yield Violation(f"standbys.{name}", name, f"must be another name: the {name} goes by this one")


def followers_answer_within_a_takeover(mission: Mission) -> Iterator[Violation]:
    """With standbys, every follower publishes four positions or more within `takeover`, for its votes."""
    slowest = min(mission.followers, key=lambda name: mission.robots[name].rate)
    least = MIN_POSITIONS / mission.robots[slowest].rate
    if mission.standbys and mission.takeover < least:
        legal = f"must be at least {least:.3g} s, in which {slowest} publishes its position"
        yield Violation("takeover", mission.takeover, f"{legal} {MIN_POSITIONS} times")


def agents_listen_apart(mission: Mission) -> Iterator[Violation]:
    """No two processes have the same `endpoint`."""
    taken: dict[str, str] = {}
    tables = {f"robots.{name}": (name, robot.endpoint) for name, robot in mission.robots.items()}
    tables |= {f"standbys.{name}": (name, standby.endpoint) for name, standby in mission.standbys.items()}
    for table, (name, endpoint) in tables.items():
        if endpoint is None:
            continue
        if endpoint in taken:
            own = "a robot's own" if table.startswith("robots.") else "the standby's own"
            yield Violation(f"{table}.endpoint", endpoint, f"must be {own}; {taken[endpoint]} has the same")
        taken[endpoint] = name


def namespaces_are_ros_names(mission: Mission) -> Iterator[Violation]:
    """A `namespace` is empty, or a ROS namespace without its leading slash."""
    for name, robot in mission.robots.items():
        if robot.namespace is not None and not is_namespace(robot.namespace):
            yield Violation(
                f"robots.{name}.namespace",
                robot.namespace,
                "must be a ROS namespace without its leading slash, such as 'robot1' or 'lab/robot1': "
                "letters, digits and _, no part beginning with a digit; or '' for none",
            )


def ros_names_are_a_robots_own(mission: Mission) -> Iterator[Violation]:
    """Two robots with the same `robot_endpoint` have no topic in common."""
    together: dict[object, dict[str, RosNames]] = {}
    for name in mission.followers:
        robot = mission.robots[name]
        if robot.robot_endpoint is None:
            continue
        # the domain of a bridge does not show in its keys
        domain = robot.domain if robot.ros == "rmw_zenoh" else None
        # each computer has a loopback of its own
        local = robot.robot_endpoint.partition("/")[2].startswith(("127.", "localhost:", "[::1]:"))
        computer = robot.endpoint.rpartition(":")[0] if local and robot.endpoint is not None else ""
        place = (computer, robot.robot_endpoint, robot.ros, domain)
        together.setdefault(place, {})[name] = RosNames.of(name, robot)
    for robots in together.values():
        shared = clash(robots)
        if shared is not None:
            first, second, topic = shared
            legal = f"must keep its topics apart from {first}'s, which has the same robot_endpoint"
            key = f"robots.{second}.namespace"
            yield Violation(key, robots[second].namespace, f"{legal}: both have /{topic}")


def steps_leave_room(mission: Mission) -> Iterator[Violation]:
    """`speed_step` is below `max_speed`, and `turn_rate_step` below `max_turn_rate`."""
    for name in mission.followers:
        robot = mission.robots[name]
        for step, limit in (("speed_step", "max_speed"), ("turn_rate_step", "max_turn_rate")):
            value, most = getattr(robot, step), getattr(robot, limit)
            if value >= most:
                legal = f"must be less than its {limit} of {most:g}, or all commands are zero"
                yield Violation(f"robots.{name}.{step}", value, legal)


def a_scanner_sees_something(mission: Mission) -> Iterator[Violation]:
    """`range_min` of every simulated scanner is below its `range_max`."""
    for name in mission.followers:
        scanner = mission.simulated_scanner.scanner(mission.robots[name].scan)
        if scanner.range_min >= scanner.range_max:
            legal = f"must be less than its range_max of {scanner.range_max:g} m"
            yield Violation("simulated_scanner.range_min", scanner.range_min, legal)


def required_scanners_see_near_enough(mission: Mission) -> Iterator[Violation]:
    """A required scanner of a named model sees all that is more than `radius` and `margin` away."""
    for name in mission.followers:
        robot = mission.robots[name]
        if robot.scanner == "required" and robot.margin < robot.unseen_margin:
            legal = f"must be at least {robot.unseen_margin:.3g} m: nearer than that its scanner sees nothing"
            yield Violation(f"robots.{name}.scan.margin", robot.margin, legal)


def robots_that_see_have_scanners(mission: Mission) -> Iterator[Violation]:
    """A robot with `measurement = "scan"` has a range scanner, and is localised by its odometry."""
    for name in mission.followers:
        robot = mission.robots[name]
        if robot.measurement != "scan":
            continue
        key = f"robots.{name}.measurement"
        if robot.scanner == "none":
            yield Violation(key, "scan", 'needs a range scanner: scanner = "required" (or "optional")')
        if robot.localisation != "odometry":
            yield Violation(key, "scan", 'needs localisation = "odometry", which it corrects')
        if robot.odometry_frame == "map":
            yield Violation(key, "scan", 'needs an odometry_frame of its own, "start" or "world": not "map"')


def leader_waits_for_followers(mission: Mission) -> Iterator[Violation]:
    """Every robot that the leader waits for is a follower."""
    for name in () if mission.cohesion is None else mission.cohesion.robots:
        if name not in mission.followers:
            legal = f"must be a follower: {', '.join(mission.followers)}"
            yield Violation("cohesion.robots", name, legal)


def maps_place_odometry(mission: Mission) -> Iterator[Violation]:
    """A localiser's map places odometry: a robot that is seen from outside has none."""
    for name in mission.followers:
        robot = mission.robots[name]
        if robot.odometry_frame == "map" and robot.localisation != "odometry":
            yield Violation(f"robots.{name}.odometry_frame", "map", 'needs localisation = "odometry"')


def bounds_hold_the_start(mission: Mission) -> Iterator[Violation]:
    """Bounds are least before greatest; all starts and the slots of the first shape lie inside."""
    if mission.bounds is None:
        return
    leader = mission.robots[mission.leader].start.position
    turned = mission.leader_heading if mission.turning else 1.0
    for axis, (least, most) in (("x", mission.bounds.x), ("y", mission.bounds.y)):
        if least >= most:
            yield Violation(f"bounds.{axis}", [least, most], "must be [least, most] in metres")
        for name, robot in mission.robots.items():
            value = getattr(robot.start, axis)
            if not least <= value <= most:
                legal = f"must be within the bounds, {least:g} to {most:g} m"
                yield Violation(f"robots.{name}.start.{axis}", value, legal)
        for name in mission.followers:
            slot = leader + turned * mission.slot(name)
            value = slot.real if axis == "x" else slot.imag
            if not least <= value <= most:
                legal = f"must hold the first shape at the start; {name}'s slot is at {axis} = {value:.4g} m"
                yield Violation(f"bounds.{axis}", [least, most], legal)


RULES = (
    leader_is_a_robot,
    neighbours_exist,
    avoided_have_bodies,
    shapes_are_complete,
    tree_from_the_leader,
    leader_slower_than_followers,
    only_the_last_leg_is_endless,
    starts_do_not_touch,
    standbys_have_names_of_their_own,
    followers_answer_within_a_takeover,
    agents_listen_apart,
    namespaces_are_ros_names,
    ros_names_are_a_robots_own,
    steps_leave_room,
    a_scanner_sees_something,
    required_scanners_see_near_enough,
    robots_that_see_have_scanners,
    maps_place_odometry,
    leader_waits_for_followers,
    bounds_hold_the_start,
)


def _list(names: Any) -> str:
    return ", ".join(names) or "none"


def _others(mission: Mission, name: str) -> str:
    return _list(other for other in mission.robots if other != name)


def too_close(centres: Sequence[complex], radii: Sequence[float]) -> Iterator[tuple[int, int, float]]:
    """(i, j, distance [m]) of any discs i < j not further apart than their radii, by j, then by i.

    A sweep along x: only discs within reach are compared, so thousands of them take no time.
    """
    order = sorted(range(len(centres)), key=lambda i: centres[i].real)
    widest = 2.0 * max(radii, default=0.0)
    found = []
    for place, i in enumerate(order):
        for after in range(place + 1, len(order)):
            j = order[after]
            if centres[j].real - centres[i].real > widest:
                break
            distance = abs(centres[j] - centres[i])
            if distance <= radii[i] + radii[j]:
                found.append((max(i, j), min(i, j), distance))
    for j, i, distance in sorted(found):
        yield i, j, distance
