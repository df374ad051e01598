"""`formation simulate`: simulate a mission's closed loop, without a network, faster than real time."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from formation.deploy.arguments import (
    add_dask,
    add_json,
    add_mission,
    check_file,
    number,
    parser,
    print_result,
    read_driven,
    whole,
)
from formation.deploy.refusal import Refusal, refuse_os_errors
from formation.deploy.rehearsal.workers import each
from formation.deploy.terminal.bar import Bar, message_if_slow, warn_if_slow
from formation.deploy.terminal.units import metres
from formation.mission.model import MAX_HORIZON, Mission
from formation.mission.route import Route
from formation.monitor.report.drawing import draw
from formation.simulation.body import PROFILES, Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import Result, simulate

MAX_RUNS = 100_000
MAX_SPREAD, MAX_NOISE = 1e4, 10.0
"""Greatest distance of random starts from slots, and greatest noise of odometry [m]."""
BLOCK_RUNS = 500
"""Runs that go in step, with random numbers of their own."""
HEADING_TOLERANCE = 1e-9
"""Headings that differ by less count as equal [rad], as for waypoints in a line."""
EXAMPLES = """\
  formation simulate six_robots                          one run, from the mission's own starts
  formation simulate six_robots --runs 400 --law paper   many, from random starts; compare the laws
  formation simulate six_robots --runs 400 --avoid       robots also avoid those that they do not measure
  formation simulate two_chains --runs 100 --delay 0.1 --loss 0.2
  formation simulate six_robots --plot fig2.png          the panels of the paper's Fig. 2

Exit code 0: it was simulated, whether the formation converged or not; 2: it was not.
"""


def main(arguments: Sequence[str]) -> int:
    """Simulate a mission; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_driven(options.mission, options.law)
    if options.avoid:
        mission = _all_avoiding(mission)
    if options.plot is not None:
        _check_plot(options.plot)
    warn_if_slow()
    try:
        result = _simulated(mission, options)
    except ValueError as error:
        raise Refusal(f"simulate: {error}") from None
    except MemoryError:
        raise Refusal(f"--runs {options.runs}: more than fits into memory; take fewer") from None
    if options.plot is not None and result.history is not None:
        with refuse_os_errors(f"--plot {options.plot}"):
            draw(result.history, options.plot)
    drawn = options.runs > 1 or options.spread is not None
    text = words(mission, options.seed if drawn else None, result)
    figure = "" if options.plot is None else f"\n  figure           {options.plot}"
    print_result(options, text + figure, lambda: report(mission, options, result))
    return 0


def _all_avoiding(mission: Mission) -> Mission:
    """Return the mission in which all robots avoid all others."""
    robots = {name: robot.model_copy(update={"avoid": "all"}) for name, robot in mission.robots.items()}
    return mission.changed(robots=robots)


def _simulated(mission: Mission, options: argparse.Namespace) -> Result:
    """Simulate all runs, in blocks: what a block gives depends on its number and `options` alone.

    Raises ValueError, MemoryError, Refusal.
    """
    sizes = [min(BLOCK_RUNS, options.runs - first) for first in range(0, options.runs, BLOCK_RUNS)]
    block = partial(_block, mission, _body(mission, options), options)
    with ExitStack() as stack:
        bar = stack.enter_context(Bar(f"{mission.name}, {options.runs} runs"))
        first = stack.enter_context(ExitStack())
        text = "compiling the law; the first time that takes ten seconds and more"
        first.enter_context(message_if_slow(text))

        def show_progress(share: float) -> None:
            first.close()  # at the first progress all is compiled
            bar.at(share)

        if len(sizes) == 1 and not options.dask:
            return block((0, sizes[0]), show_progress)
        began, results = time.monotonic(), []
        for result in each(block, enumerate(sizes), dask=options.dask):
            results.append(result)
            show_progress(len(results) / len(sizes))
        return _merged(results, time.monotonic() - began)


def _block(
    mission: Mission,
    body: Body,
    options: argparse.Namespace,
    numbered: tuple[int, int],
    progress: Callable[[float], None] | None = None,
) -> Result:
    """Simulate one block, given as its number and its runs."""
    number, runs = numbered
    drawn = options.runs > 1 or options.spread is not None
    return simulate(
        mission,
        runs=runs,
        seed=(options.seed, number) if number else options.seed,
        options=Options(delay=options.delay, loss=options.loss, body=body),
        horizon=options.horizon,
        spread=options.spread,
        starts="random" if drawn else None,
        progress=progress,
        keep=options.plot is not None and number == 0,
    )


def _merged(results: Sequence[Result], seconds: float) -> Result:
    """Join the results of all blocks, without the errors over time; `seconds` is how long they took."""

    def joined(name: str) -> Any:
        return np.concatenate([getattr(one, name) for one in results])

    return replace(
        results[0],
        **{
            name: joined(name)
            for name in ("settling_time", "converged", "final_error", "nearest", "deadlocks")
        },
        error=results[0].error[:, :0],
        wall_time=seconds,
        robot_steps=sum(one.robot_steps for one in results),
    )


def words(mission: Mission, seed: int | None, result: Result) -> str:
    """Return the result for people; `seed` is that of drawn starts, None for the mission's own starts."""
    found = result.summary()
    runs, settling, final = found["runs"], found["settling_time"], found["final_error"]
    converged = round(found["converged_fraction"] * runs)
    where = f"{runs} random start{'' if runs == 1 else 's'}, seed {seed}"
    if seed is None:
        where = "the mission's own starts"
    lines = [
        f"{mission.name}, {result.law} law, {where}",
        f"  converged        {converged} of {runs}: error under {metres(result.settled)} until the end",
    ]
    if settling["median"] is not None:
        more = "" if runs == 1 else f" median, {settling['p95']:.2f} s for 95 %"
        lines.append(f"  settling time    {settling['median']:.2f} s{more}")
    if runs == 1:
        lines.append(f"  final error      {metres(final['max'])}")
    else:
        lines.append(f"  final error      {metres(final['median'])} median, {metres(final['max'])} worst")
    lines += _bodies(mission, result)
    if missing := left_out(mission):
        lines.append(f"  not simulated    {', '.join(missing)}; formation run has them")
    lines.append(
        f"  took             {found['wall_time']:.2f} s, "
        f"{found['robot_steps_per_second']:,.0f} robot steps a second"
    )
    return "\n".join(lines)


def _bodies(mission: Mission, result: Result) -> Iterator[str]:
    """Yield whether bodies have touched, and the result for robots in deadlock."""
    found = result.summary()
    if not result.watched:
        yield "  bodies           not watched: collisions are off"
    if found["nearest"] is None:
        return
    runs, touched = found["runs"], found["touched"]
    where = ("they touch" if touched else "none touch") if runs == 1 else f"touch in {touched} of {runs} runs"
    idle = mission.collisions.mode != "on" or not any(mission.avoided_by(name) for name in mission.followers)
    nearest = "" if touched else f", {metres(found['nearest'])} apart at least"
    all_avoided = all(
        len(mission.avoided_by(name)) == len(mission.followers) - 1 for name in mission.followers
    )
    how = ""
    if not mission.law.controller.collision_filter:
        how = f"; the {mission.law.kind} law has no collision filter: robots do not avoid each other"
    elif idle:
        how = "; robots do not avoid each other"
    elif touched and not all_avoided:
        how = "; robots avoid only those that they measure: try --avoid, or scanners (formation rehearse)"
    yield f"  bodies           {where}{nearest}{how}"
    if found["deadlocks"]:
        yield f"  deadlocks        {found['deadlocks']}, after each of which a robot went another way"


def left_out(mission: Mission) -> list[str]:
    """Return the mission's features that are not simulated."""
    world, robots = mission.simulation, [mission.robots[name] for name in mission.followers]
    found = {
        "scanners": any(robot.scanner != "none" for robot in robots),
        "posts": bool(world.posts),
        "walls": bool(world.walls),
        "turning": mission.turning and _turns(mission),
        "cohesion": mission.cohesion is not None,
    }
    return [what for what, there in found.items() if there]


def _turns(mission: Mission) -> bool:
    """Return whether the leader's heading changes on its route."""
    arcs = Route.of(mission).arcs
    return any(arc.turn_rate != 0.0 or abs(arc.heading - arcs[0].heading) > HEADING_TOLERANCE for arc in arcs)


def report(mission: Mission, options: argparse.Namespace, result: Result) -> dict[str, Any]:
    """Return the result for a script."""
    plot = {} if options.plot is None else {"plot": str(options.plot)}
    return {
        "mission": mission.name,
        "law": result.law,
        "seed": options.seed,
        **result.summary(),
        "not_simulated": left_out(mission),
        **plot,
    }


def _body(mission: Mission, options: argparse.Namespace) -> Body:
    """Return the mission's robot, with settings from the command line."""
    body = Body.of(mission.simulated_robot)
    if options.noise is not None:
        body = body._replace(position_noise=options.noise)
    if options.quantised:
        steps = PROFILES["turtlebot3_burger"]
        body = body._replace(speed_step=steps.speed_step, turn_rate_step=steps.turn_rate_step)
    return body


def _check_plot(path: Path) -> None:
    """Raise, before the simulation, for a figure that cannot be written."""
    if find_spec("matplotlib") is None:
        raise ModuleNotFoundError("No module named 'matplotlib'", name="matplotlib")
    check_file("--plot", path, ".png", ".svg", ".pdf")


def _options() -> argparse.ArgumentParser:
    options = parser("simulate", "Simulate a mission: the agents' own law, without a network.", EXAMPLES)
    add_mission(options)
    options.add_argument(
        "--runs", type=whole(1, MAX_RUNS), default=1, metavar="N", help="number of runs (default 1)"
    )
    options.add_argument(
        "--seed", type=whole(0), default=0, metavar="S", help="seed of all random numbers (default 0)"
    )
    options.add_argument(
        "--horizon",
        type=number(0.0, MAX_HORIZON, "s", open_below=True),
        metavar="S",
        help=f"length of a run, at most {MAX_HORIZON:g} [s]",
    )
    options.add_argument(
        "--spread",
        type=number(0.0, MAX_SPREAD, "m"),
        metavar="M",
        help="random starts within ± this of the slots [m]",
    )
    worse = options.add_argument_group("a worse world")
    worse.add_argument(
        "--delay",
        type=number(0.0, 60.0, "s"),
        default=0.0,
        metavar="S",
        help="age of neighbours' positions [s]",
    )
    worse.add_argument(
        "--loss", type=number(0.0, 1.0), default=0.0, metavar="P", help="share of these that is lost, 0 to 1"
    )
    worse.add_argument(
        "--noise",
        type=number(0.0, MAX_NOISE, "m"),
        metavar="M",
        help="standard deviation of odometry positions [m]",
    )
    worse.add_argument(
        "--quantised", action="store_true", help="cut commands to hundredths, as TurtleBot3 does"
    )
    options.add_argument(
        "--avoid",
        action="store_true",
        help='all robots avoid all others, as with avoid = "all" in the mission',
    )
    options.add_argument("--plot", type=Path, metavar="FILE", help="draw the first run: .png, .svg or .pdf")
    add_dask(options)
    add_json(options)
    return options
