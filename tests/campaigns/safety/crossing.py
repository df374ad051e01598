"""Robots whose ways to their slots cross: do bodies touch, do all come into formation, how late?"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from formation.control.avoidance import Avoidance, AvoidanceParameters, Obstacle, avoid, brake
from formation.control.controller import Limits
from formation.control.pipeline import ControlState, Outcome
from formation.control.plane import rotation
from formation.control.unicycle import Command
from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.ensemble import MIN_START_CLEARANCE
from formation.simulation.ensemble import Options as Simulated
from formation.simulation.simulate import Result, simulate
from tests.campaigns.document import Found
from tests.campaigns.figures import filled, over_rounds, span
from tests.campaigns.parts import table
from tests.campaigns.safety.part import Options, bar, reported, reporting
from tests.support.fleet import Fleet
from tests.unit.formation import scenarios

CALLS = 2000  # of each round
ALONE, WHOLE = "the filter itself", "all that an agent does for it"


def measured(rounds: int) -> Any:
    """Both [µs], over rounds."""
    return over_rounds([{ALONE: microseconds(alone()), WHOLE: in_a_fleet()} for _ in range(rounds)])


def microseconds(step: Callable[[], object]) -> float:
    """CPU time of one call [µs]."""
    began = time.process_time()
    for _ in range(CALLS):
        step()
    return 1e6 * (time.process_time() - began) / CALLS


def alone() -> Callable[[], object]:
    """One step among four that come nearer from all sides, two with right of way."""
    around = [
        Obstacle(0.45 * rotation(0.4 + 1.5 * k), 0.1, -0.3 * rotation(0.4 + 1.5 * k), first=k < 2)
        for k in range(4)
    ]
    limits, parameters = Limits(0.2, 1.5, 1.5), AvoidanceParameters(0.1, 0.02, 0.15)
    return lambda: avoid(Command(1.0, 0.3), around, parameters, limits, 0.2 + 0j, Avoidance(), 0.05)


def in_a_fleet() -> float:
    """Five robots exchange their slots: where one has to act with all four others nearest to it [µs]."""
    fleet = Fleet(scenarios.exchanged(load("six_robots")))
    took: dict[float, float] = {}
    for name in fleet.agents:
        _watch(fleet, name, took)
    fleet.run(4.0)
    return took[min(took)]


def _watch(fleet: Fleet, name: str, took: dict[float, float]) -> None:
    """Time a filter that has to act whenever it has all others nearer than any had before.

    `took` has the time of one step [µs] by how far away the furthest other was, from centre to centre [m].
    """
    one, params, requested = fleet.agents[name].avoiding, fleet.agents[name]._params, list[Any]()
    obstacles, stepped = one.obstacles, one.stepped

    def watched(*given: Any) -> Any:
        requested[:] = given
        return obstacles(*given)

    def whole(state: ControlState, outcome: Outcome) -> None:
        robots, strangers, _ = obstacles(*requested)
        around = [*robots, *strangers]
        done, _ = avoid(outcome.target, around, params.avoidance, params.limits, 0j, state.avoidance, 0.05)
        brake(done, around, params.avoidance)

    def noted(state: ControlState, outcome: Outcome) -> None:
        stepped(state, outcome)
        here = fleet.plant(name).position
        furthest = max(abs(fleet.plant(other).position - here) for other in fleet.agents)
        if one.state.acting and furthest < min(took, default=np.inf):
            took[furthest] = microseconds(lambda: whole(state, outcome))

    one.obstacles, one.stepped = watched, noted  # type: ignore[method-assign, assignment]


TITLE = "Crossing starts"
ABOUT = """\
Random starts in `formation simulate`'s own loop, 20 Hz, 60 s: control points within ± 3 m of their slots,
any heading, bodies of 10 cm at least 5 cm apart. Robots reach 1.5 m/s and 1.5 rad/s and do not know their
headings at first; the law `field` with gain 10 1/s, L = 0.2 m, no lag, `avoid = "all"`, a margin of 2 cm.
*6* is `six_robots`, five robots that drive and a leader that is a point; 12 and 25 drive in a block of
columns 1 m apart, each measuring two of the row before. The same starts are driven with the collision filter
and without. A run *comes into formation* when the error summed over all edges stays under the mission's bound
until the end, for ten seconds at least."""
ROBOTS = (6, 12, 25)
RUNS = 1000  # starts of each kind
LASTS: dict[str, Any] = {"step": 0.05, "horizon": 60.0}  # [s]
ON_CIRCLE, DELAYS, NOISE, OPPOSITE_RUNS = (4, 6, 8, 12), (0.0, 0.1, 0.2), 0.002, 100  # [s], [m]
OPPOSITE_LASTS: dict[str, Any] = {"step": 0.05, "horizon": 90.0, "starts": "mission"}  # [s]
SPREAD, STREWN = 3.0, 0.2  # of starts at random, and of starts in somebody else's slot, to either side [m]
CONVERGED, SLOWER, MICROSECONDS = 0.995, 1.5, 100.0  # the bars
HEADER = (
    "robots | starts | runs that touch, without and with | nearest bodies, with | "
    "come into formation, without and with | median settling time, without and with | ratio | deadlocks"
)


def run(options: Options) -> Found:
    """Both kinds of starts for every size, and what a step of the filter costs."""
    runs = 20 if options.quick else RUNS
    found = [{"robots": robots, **random(robots, runs)} for robots in ROBOTS]
    permuted = [{"robots": robots, **exchanged(robots, runs)} for robots in ROBOTS]
    circles = [opposite(robots, 2 if options.quick else OPPOSITE_RUNS) for robots in ON_CIRCLE]
    step = measured(1 if options.quick else 10)
    parts = {"random": found, "permuted": permuted, "opposite": circles, "step": step}
    return {**parts, "bars": bars(found, circles, step)}


def bars(random: Sequence[Found], circles: Sequence[Found], step: Found) -> list[dict[str, Any]]:
    touched = sum(one["with"]["touched"] for one in random)
    into = [one["with"]["converged_fraction"] for one in random]
    slower = [one["ratio"] for one in random]
    whole = step[WHOLE]
    sizes, runs = ", ".join(str(one["robots"]) for one in random), random[0]["with"]["runs"]
    shares = ", ".join(f"{100 * share:.1f} %" for share in into)
    ratios = ", ".join(f"{ratio:.2f}×" for ratio in slower)
    quick = whole["median"] < MICROSECONDS
    return [
        bar(
            f"no two bodies touch, {sizes} robots, {runs} random starts each",
            f"{touched} runs touch",
            not touched,
        ),
        bar("at least 99.5 % come into formation", shares, min(into) >= CONVERGED),
        bar(
            f"all on a circle arrive opposite, {', '.join(str(one['robots']) for one in circles)} robots",
            f"{sum(one['left'] for one in circles)} runs do not",
            not any(one["left"] for one in circles),
        ),
        bar("median settling time at most 1.5× of without", ratios, max(slower) <= SLOWER),
        bar("a step of the filter under 100 µs with four neighbours", span(whole, 0, " µs"), quick),
    ]


def section(found: Found) -> str:
    parts = [
        table(HEADER, map(_row, found["random"])),
        filled(
            "*Deadlocks* are how often a robot that was kept for half a second went to the right for a",
            "while, all runs together. Harder, and without a bar: each robot starts in a slot dealt out",
            f"at random, within ± {STREWN:g} m, where all have to pass each other in little room.",
        ),
        table(HEADER, map(_row, found["permuted"])),
        filled(
            "Hardest: robots of 1 m/s on a circle start opposite to their slots, so that all meet in",
            f"the middle at the same time, with {1e3 * NOISE:g} mm of noise and positions of others that",
            f"are late by {', '.join(f'{one:g}' for one in DELAYS)} s; {OPPOSITE_LASTS['horizon']:g} s.",
        ),
        table(
            "robots | runs | nearest bodies | not in formation | slowest settling time | deadlocks",
            map(_circle_row, found["opposite"]),
        ),
        filled(
            "CPU time of one step in plain Python, as agents run it, medians of rounds, in brackets the",
            "lowest and the highest: `avoid` among four that come nearer from all sides; and positions,",
            "filter and brake of an agent of five that exchange their slots, at the moment at which one",
            "that has to act has all others nearest.",
        ),
        table(" | CPU time", [f"{name} | {span(one, 0, ' µs')}" for name, one in found["step"].items()]),
    ]
    return "\n".join(parts)


def _row(one: Found) -> str:
    off, on = one["without"], one["with"]
    touched, into = (
        ", ".join(f"{100 * share:.1f} %" for share in shares)
        for shares in (
            (off["touched"] / off["runs"], on["touched"] / on["runs"]),
            (off["converged_fraction"], on["converged_fraction"]),
        )
    )
    return (
        f"{one['robots']} | {on['runs']} | {touched} | {100 * on['nearest']:.1f} cm | {into} | "
        f"{off['settling']:.2f} s, {on['settling']:.2f} s | {one['ratio']:.2f}× | {on['deadlocks']}"
    )


def _circle_row(one: Found) -> str:
    return (
        f"{one['robots']} | {one['runs']} | {100 * one['nearest']:.1f} cm | {one['left']} | "
        f"{one['slowest']:.1f} s | {one['deadlocks']}"
    )


def opposite(robots: int, runs: int) -> Found:
    """Robots that start opposite to their slots on a circle, for each of DELAYS."""
    mission = scenarios.opposite(robots)
    body = Body.of(mission.simulated_robot)._replace(position_noise=NOISE)
    results = [
        simulate(mission, runs=runs, options=Simulated(delay=delay, body=body), **OPPOSITE_LASTS)
        for delay in reported(f"crossing: {robots} on a circle", list(DELAYS))
    ]
    settling = np.concatenate([one.settling_time for one in results])
    return {
        "robots": robots,
        "runs": len(settling),
        "nearest": min(float(one.nearest.min()) for one in results),
        "left": sum(int((~one.converged).sum()) for one in results),
        "slowest": float(np.nanmax(settling)),
        "deadlocks": sum(int(one.deadlocks.sum()) for one in results),
    }


def random(robots: int, runs: int) -> Found:
    """Starts as `formation simulate` draws them, without the filter and with it."""

    def drive(name: str, filtered: Simulated) -> list[Result]:
        tell = reporting(f"crossing: {robots}, {name} the filter")
        return [simulate(team(robots), runs=runs, starts="random", options=filtered, progress=tell, **LASTS)]

    return _both(drive)


def exchanged(robots: int, runs: int) -> Found:
    """Starts in slots dealt out at random, without the filter and with it."""
    mission, draw = team(robots), np.random.default_rng(robots)
    dealt = [elsewhere(mission, draw) for _ in range(runs)]

    def drive(name: str, filtered: Simulated) -> list[Result]:
        told = reported(f"crossing: {robots} in others' slots, {name} the filter", dealt)
        return [simulate(one, options=filtered, **LASTS) for one in told]

    return _both(drive)


def _both(drive: Callable[[str, Simulated], list[Result]]) -> Found:
    """What comes of the same starts without the filter and with it."""
    found = {}
    for name, on in (("without", False), ("with", True)):
        results = drive(name, Simulated(avoid=on))
        converged, nearest, settling = (
            np.concatenate([getattr(one, figure) for one in results])
            for figure in ("converged", "nearest", "settling_time")
        )
        found[name] = {
            "runs": len(converged),
            "touched": int((nearest < 0.0).sum()),
            "nearest": float(nearest.min()),
            "converged_fraction": float(converged.mean()),
            "settling": float(np.median(settling[converged])),
            "deadlocks": sum(int(one.deadlocks.sum()) for one in results),
        }
    return {**found, "ratio": found["with"]["settling"] / found["without"]["settling"]}


def team(robots: int) -> Mission:
    """`six_robots`, or a block of so many, all avoiding all."""
    return scenarios.clearing(scenarios.six() if robots == 6 else block(robots))


def block(robots: int) -> Mission:
    """Rows of three or five behind the leader; the first measures it, all others two of the row before."""
    wide = 3 if robots <= 12 else 5
    slots: list[complex] = [0j]
    neighbours: list[tuple[int, ...]] = [()]
    for number in range(robots):
        row, column = divmod(number, wide)
        slots.append(complex(-(row + 1), column - (wide - 1) / 2))
        before = 1 + (row - 1) * wide + column
        beside = before + 1 if column < wide - 1 else before - 1
        neighbours.append((0,) if row == 0 else (before, beside))
    return scenarios.build(
        np.array(slots),
        neighbours,
        law={"k_i": 1.0},
        robot={"control_point_offset": 0.2, "max_speed": 1.5, "max_turn_rate": 1.5},
        simulation={"spread": SPREAD},
    )


def elsewhere(mission: Mission, draw: np.random.Generator) -> Mission:
    """The same with followers that start in slots dealt out at random, no two bodies too near."""
    slots, count = np.array(mission.slots()[1:]), len(mission.followers)
    offset = np.array([mission.robots[name].control_point_offset for name in mission.followers])
    radius = np.array([mission.robots[name].radius for name in mission.followers])
    least = radius[:, None] + radius + MIN_START_CLEARANCE
    while True:
        heading = draw.uniform(-np.pi, np.pi, count)
        away = draw.uniform(-STREWN, STREWN, (2, count))
        position = draw.permutation(slots) + away[0] + 1j * away[1] - offset * np.exp(1j * heading)
        apart = np.abs(position[:, None] - position) + 1e9 * np.eye(count)
        if (apart >= least).all():
            break
    robots = dict(mission.robots)
    for name, at, course in zip(mission.followers, position.tolist(), heading.tolist(), strict=True):
        start = robots[name].start.model_copy(
            update={"x": at.real, "y": at.imag, "heading_deg": float(np.degrees(course))}
        )
        robots[name] = robots[name].model_copy(update={"start": start})
    return mission.model_copy(update={"robots": robots})
