"""A hexagon of robots that see each other with range scanners, and how true their relative positions are."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from formation.agent.simulated.plant import Moving
from formation.agent.simulated.simulated import Ranging, kinematic
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.ros2.messages import LaserScan
from tests.support.drivers import DRIVERS, SAMPLES
from tests.support.fleet import Fleet

STRAIGHT = "[[route]]\nspeed = 0.15\nheading_deg = 0"
HEXAGON: Mapping[str, tuple[float, float]] = {
    "robot2": (-0.5, 0.866025),
    "robot3": (-1.5, 0.866025),
    "robot4": (-2.0, 0.0),
    "robot5": (-1.5, -0.866025),
    "robot6": (-0.5, -0.866025),
    "robot7": (-1.0, 0.0),
}
"""Slots relative to the leader [m]: five of the corners, and the middle."""
NEIGHBOURS: Mapping[str, tuple[str, ...]] = {
    "robot2": ("led",),
    "robot3": ("led", "robot2"),
    "robot4": ("robot2", "robot3"),
    "robot5": ("robot3", "robot4"),
    "robot6": ("robot4", "robot5"),
    "robot7": ("robot2", "robot3"),
}
Team = Mapping[str, tuple[tuple[float, float], tuple[str, ...]]]
"""Slot of each robot, relative to the leader [m], and its neighbours."""
HEXAGON_TEAM: Team = {name: (HEXAGON[name], NEIGHBOURS[name]) for name in HEXAGON}
SQUARE_TEAM: Team = {
    "robot2": ((-0.6, 0.4), ("led",)),
    "robot3": ((-0.6, -0.4), ("led", "robot2")),
    "robot4": ((-1.4, 0.4), ("robot2", "robot3")),
    "robot5": ((-1.4, -0.4), ("robot3", "robot2", "robot4")),
}
TRIANGLE = ("robot2", "robot3", "robot7")
"""Robots of a smaller team."""


class Errors(NamedTuple):
    """How scanners measure, and how robots stand at the start."""

    lost: float = 0.1
    """Share of lost beams."""
    scale: float = 0.0
    """Systematic error of distances, as a share."""
    mounting_deg: float = 0.0
    """Systematic error of directions [°]."""
    beams: int | None = None
    """Beams in a turn, if not those of the scanner's model."""
    start: float = 0.02
    """Standard deviation of start positions, per axis [m]."""
    start_deg: float = 1.0
    """Standard deviation of start headings [°]."""


def hexagon(
    route: str = STRAIGHT,
    errors: Errors = Errors(),  # noqa: B008 - a constant
    *,
    measurement: str = "scan",
    scanner: str = "required",
    robots: Sequence[str] = (),
    team: Team = HEXAGON_TEAM,
    simulated: str = "",
    scan: str = "rate = 5",
    tables: str = "",
) -> Mission:
    """TurtleBot3 Burgers of a `team` with scanners behind a virtual leader; some `robots`, by default all.

    `simulated` are more keys of [simulated_robot], `scan` of `scan`, `tables` more tables.
    """
    robots = robots or tuple(team)
    lines = [
        'name = "hexagon"', 'leader = "led"', "[law]", "k_p = 1.5", "k_i = 0.3", "[robot]",
        "control_point_offset = 0.1", "max_speed = 0.21", "max_turn_rate = 2.6", "radius = 0.105",
        "rate = 20", f'measurement = "{measurement}"', 'odometry_frame = "start"', f'scanner = "{scanner}"',
        "speed_step = 0.01", "turn_rate_step = 0.01", 'cmd_vel = "twist_stamped"',
        f"scan = {{ {scan}, x = -0.032 }}", "seen = { radius = 0.035, x = -0.032 }",
        "[collisions]", "lag = 0.1", "[cohesion]", "error = 0.3",
        "[simulated_robot]", 'profile = "turtlebot3_burger"', simulated,
        "[simulated_scanner]", f"lost = {errors.lost}", f"scale = {errors.scale}",
        f"mounting_error_deg = {errors.mounting_deg}",
        *([] if errors.beams is None else [f"beams = {errors.beams}"]),
        "[shapes.hexagon]", *(f"{name} = {list(team[name][0])}" for name in robots),
        "[robots.led]", "start = { x = 0.0, y = 0.0 }",
    ]  # fmt: skip
    for name in robots:
        (x, y), measured = team[name]
        neighbours = ", ".join(f'"{one}"' for one in measured)
        lines += [f"[robots.{name}]", f"neighbours = [{neighbours}]"]
        lines += [f"start = {{ x = {x - 0.1}, y = {y}, heading_deg = 0 }}"]
    return parse("\n".join((*lines, route, tables)))


def displaced(of: Mission, errors: Errors, seed: int) -> Mission:
    """The mission as it really is: robots are not exactly on their start poses."""
    chance, robots = random.Random(seed), dict(of.robots)
    for name in of.followers:
        spec = robots[name]
        start = {
            "x": spec.start.x + chance.gauss(0.0, errors.start),
            "y": spec.start.y + chance.gauss(0.0, errors.start),
            "heading_deg": spec.start.heading_deg + chance.gauss(0.0, errors.start_deg),
        }
        robots[name] = spec.model_copy(update={"start": spec.start.model_copy(update=start)})
    return of.changed(robots=robots)


def fleet_of(mission: Mission, errors: Errors = Errors(), seed: int = 0) -> Fleet:  # noqa: B008 - a constant
    """A fleet on a virtual clock, with robots that are not exactly on their start poses."""

    def plants(of: Mission, robots: Sequence[str], number: int) -> Mapping[str, Moving]:
        return kinematic(displaced(of, errors, number), robots, number)

    return Fleet(mission, seed=seed, plants=plants)


def send_as_driver(ranging: Ranging, model: str, seed: int) -> None:
    """From now on a simulated scanner sends scans as the driver of its model does.

    It needs several times the beams of the real one: those nearest to the samples of a turn are used, which
    have other directions in each turn unless it is an LDS-01.
    """
    measured, turn_time, chance = ranging.scan, ranging._turn_time, random.Random(seed)

    def sent(stamp: float) -> LaserScan:
        fine = measured(stamp).ranges[::-1]  # in the order of time
        count, phase = SAMPLES[model], 1.0
        if model != "lds_01":
            count, phase = count + chance.randint(-3, 3), chance.random()
        places = [round((number + phase) / count * len(fine)) - 1 for number in range(count)]
        samples = [fine[place] if fine[place] > 0.0 else math.inf for place in places]
        return DRIVERS[model](samples, stamp + ranging.stamp_age, turn_time, phase)

    ranging.scan = sent  # type: ignore[method-assign]


def edges(of: Mission) -> list[tuple[str, str]]:
    """All edges between bodies."""
    return [(i, j) for i in of.followers for j in of.robots[i].neighbours if j != of.leader]


def misfit(true: Sequence[complex], wanted: Sequence[complex]) -> float:
    """Root mean square of what is left when `wanted` is turned as fits best [m]."""
    turn = sum(one * want.conjugate() for one, want in zip(true, wanted, strict=True))
    turn /= abs(turn)
    return rms(one - turn * want for one, want in zip(true, wanted, strict=True))


def rms(values: Iterable[complex]) -> float:
    """Root mean square of the lengths."""
    squares = [abs(one) ** 2 for one in values]
    return math.sqrt(sum(squares) / len(squares))


def shape_error(fleet: Fleet) -> float:
    """Error of the true relative positions over all edges, with the shape turned as fits best [m]."""
    of = fleet.mission
    at = dict(zip(of.names, fleet.points(), strict=True))
    wanted = [of.slot(j) - of.slot(i) for i, j in edges(of)]
    return misfit([at[j] - at[i] for i, j in edges(of)], wanted)


def believed_error(fleet: Fleet) -> float:
    """Error of the positions that agents publish, over all edges; their shape is turned as fits best [m]."""
    of = fleet.mission
    true = {name: robot.plant.position for name, robot in fleet.world._hosted.items()}
    believed = {name: agent.here.state.position for name, agent in fleet.agents.items()}
    return misfit(
        [true[j] - true[i] for i, j in edges(of)], [believed[j] - believed[i] for i, j in edges(of)]
    )


def blind(fleet: Fleet, robot: str) -> None:
    """From now on no beam of a robot's scanner comes back."""
    ranging = fleet.world._hosted[robot].ranging
    assert ranging is not None
    ranging._scanner = ranging._scanner._replace(lost=1.0)


def carry(fleet: Fleet, robot: str, way: complex) -> None:
    """Lift a robot and put it down elsewhere [m; world frame]; its wheels do not turn."""
    plant = fleet.plant(robot)
    plant.position += way
    plant._counts_from = plant._counts_from[0] + way, plant._counts_from[1]
