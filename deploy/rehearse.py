"""`formation rehearse`: every process of a mission on a virtual clock, with faults drawn from a seed."""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import tomlkit

from formation.agent.simulated.faults import Fault
from formation.agent.simulated.flags import NEEDED
from formation.control.laws import why_unusable
from formation.deploy.arguments import add_dask, add_json, add_mission, number, parser, print_result, whole
from formation.deploy.refusal import Refusal
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.faults import FORM, INSIDERS, KINDS, SENSORS, parse, possible, spelled
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, rehearse, shrunk
from formation.deploy.rehearsal.rules.judge import RULES
from formation.deploy.rehearsal.rules.settling import RECOVERY_TIME, RECOVERY_TIME_AMONG_OBSTACLES
from formation.deploy.rehearsal.workers import each
from formation.deploy.terminal.bar import Bar
from formation.deploy.terminal.units import metres
from formation.mission.file import MissionError, read
from formation.mission.file import parse as parse_mission
from formation.mission.model import MAX_HORIZON, Mission
from formation.monitor.recording.recorder import RecordingError
from formation.transport.runtime.command_line import needs

MAX_SEEDS = 1_000_000
MAX_SHRUNK = 5
"""Failing seeds of which the fewest faults are searched for."""
ALL, NONE = "all", "none"
EXAMPLES = """\
  formation rehearse six_robots                          one run, with faults drawn from seed 0
  formation rehearse patrol --seeds 100 --jobs 2         a hundred, on two cores
  formation rehearse patrol --seeds 20 --faults kill,cut,clock
  formation rehearse patrol --fault robot2:kill@12.3+5   this fault and no other
  formation rehearse patrol --seed 7 --record seven.mcap  then: formation report seven.mcap
  formation rehearse my_mission.toml --faults none --loss 0.1 --delay 0.1
  formation rehearse patrol --seeds 1000 --dask tcp://192.168.1.5:8786

docs/guide/rehearsal.md says what each rule and each fault means.
Exit code 0: every rule held; 1: one was broken; 2: nothing was rehearsed.
"""


def main(arguments: Sequence[str]) -> int:
    """Rehearse a mission; return the exit code: 1 if a rule was broken."""
    options = _options().parse_args(arguments)
    _check_world(options)
    mission, text = _mission(options)
    plan = _plan(mission, text, options)
    began = time.monotonic()
    try:
        verdicts = _verdicts(plan, options)
    except RecordingError as error:
        raise Refusal(str(error)) from None
    failed = [one for one in verdicts if one.violations]
    shortest = each(partial(shrunk, plan._replace(record=None)), failed[:MAX_SHRUNK], jobs=1)
    fewest = {one.seed: faults for one, faults in zip(failed, shortest, strict=False)}
    took = time.monotonic() - began
    lines = {seed: _command(options, seed, faults) for seed, faults in fewest.items()}
    print_result(
        options,
        _words(mission, plan, verdicts, lines, took),
        lambda: _report(mission, plan, verdicts, lines, took),
    )
    return 1 if failed else 0


def _verdicts(plan: Plan, options: argparse.Namespace) -> list[Verdict]:
    """Rehearse every seed; the result does not depend on the number of processes."""
    seeds = range(options.seed, options.seed + options.seeds)
    verdicts: list[Verdict] = []
    with Bar(f"{plan.mission.name}, {_count(options.seeds)}") as bar:

        def show_progress(share: float) -> None:
            bar.at((len(verdicts) + share) / options.seeds)

        here = options.jobs == 1 and not options.dask  # other processes only return verdicts
        one = partial(rehearse, plan, progress=show_progress) if here else partial(rehearse, plan)
        for verdict in each(one, seeds, options.jobs, options.dask):
            verdicts.append(verdict)
            bar.at(len(verdicts) / options.seeds)
    return verdicts


def _words(
    mission: Mission, plan: Plan, verdicts: Sequence[Verdict], lines: dict[int, str], took: float
) -> str:
    """Return the result for people."""
    failed = [one for one in verdicts if one.violations]
    text = [f"{mission.name}, {_count(len(verdicts))}, faults: {_faults(plan)}"]
    if plan.kinds and len(verdicts) == 1:
        drawn = verdicts[0].faults[len(plan.faults) :]
        text.append(f"  drawn            {', '.join(map(spelled, drawn)) or NONE}")
    for verdict in failed:
        text += [
            f"  seed {verdict.seed}: {one.rule}: {one.time:.2f} s, {one.robot or 'the fleet'}: {one.what}"
            for one in verdict.violations
        ]
        if verdict.seed in lines:
            text.append(f"    {lines[verdict.seed]}")
    text.append(f"  every rule held  {len(verdicts) - len(failed)} of {len(verdicts)}")
    settled = [one.settled_at for one in verdicts if one.settled_at is not None]
    if settled:
        text.append(
            f"  settled by       {statistics.median(settled):.1f} s median, {max(settled):.1f} s worst"
        )
    if endless := [spelled(one) for one in plan.faults if one.lasts == math.inf]:
        text.append(f"  settled by       not judged, for want of an end: {', '.join(endless)}; add +SECONDS")
    nearest = min(verdicts, key=lambda one: one.nearest)
    if nearest.nearest < math.inf:
        text.append(f"  nearest bodies   seed {nearest.seed}: {_room(nearest)}")
    seconds = sum(one.seconds for one in verdicts)
    text.append(f"  took             {took:.1f} s for {seconds:.0f} s of the fleet")
    if plan.record is not None:
        text.append(f"  recorded         {plan.record}")
    return "\n".join(text)


def _count(seeds: int) -> str:
    return "1 seed" if seeds == 1 else f"{seeds} seeds"


def _room(verdict: Verdict) -> str:
    if verdict.nearest >= 0.0:
        return f"{metres(verdict.nearest)} apart"
    judged = any(one.rule == "touch" for one in verdict.violations)
    why = "" if judged else " (rule touch: not judged with this fault, law or mission)"
    return f"overlapped by {metres(-verdict.nearest)}{why}"


def _report(
    mission: Mission, plan: Plan, verdicts: Sequence[Verdict], lines: dict[int, str], took: float
) -> dict[str, Any]:
    """Return the result for programs."""
    return {
        "mission": mission.name,
        "fingerprint": mission.fingerprint,
        "kinds": list(plan.kinds),
        "rules": list(RULES),
        "runs": [{**one.as_json(), "command": lines.get(one.seed)} for one in verdicts],
        "failed": sum(bool(one.violations) for one in verdicts),
        "recording": None if plan.record is None else str(plan.record),
        "wall_time": took,
    }


def _faults(plan: Plan) -> str:
    given = [spelled(one) for one in plan.faults]
    every = _drawable(plan.mission, plan.world, signed=plan.signed)
    kinds = [f"all {len(every)} kinds"] if plan.kinds == every else list(plan.kinds)
    return ", ".join(given + kinds) or NONE


def _lacking(world: str, *, signed: bool) -> dict[str, str]:
    """Return the kinds of faults that cannot be rehearsed with these flags, and the flag that each needs."""
    lacking = {kind: "--world kinematic" for kind in SENSORS if world != "kinematic"}
    return lacking | {kind: "--signed" for kind in INSIDERS if not signed}


def _drawable(mission: Mission, world: str, *, signed: bool) -> tuple[str, ...]:
    """Return the kinds of faults that can be drawn for `mission`."""
    lacking = _lacking(world, signed=signed)
    return tuple(kind for kind in KINDS if kind not in lacking and possible(kind, mission))


def _command(options: argparse.Namespace, seed: int, faults: Sequence[Fault]) -> str:
    """Return the command that rehearses exactly `faults` with `seed` again."""
    words = ["formation rehearse", options.mission, f"--seed {seed}"]
    words += [f"--law {options.law}"] if options.law else []
    for name in ("loss", "delay", "noise", "seconds"):
        value = getattr(options, name)
        words += [f"--{name} {value:g}"] if value else []
    words += ["--signed"] * options.signed
    words += [f"--world {options.world}"] if options.world != "kinematic" else []
    words += [f"--fault {spelled(one)}" for one in faults] or [f"--faults {NONE}"]
    return " ".join(words)


def _plan(mission: Mission, text: str, options: argparse.Namespace) -> Plan:
    """Raises Refusal."""
    try:
        faults = tuple(parse(text, mission) for text in options.fault)
    except ValueError as error:
        raise Refusal(f"--fault {error}") from None
    chosen = options.faults or (NONE if faults else ALL)
    lacking = _lacking(options.world, signed=options.signed)
    every = _drawable(mission, options.world, signed=options.signed)
    kinds = every if chosen == ALL else () if chosen == NONE else tuple(chosen.split(","))
    for kind in kinds:
        if kind in lacking:
            raise Refusal(f"--faults {kind!r}: needs {lacking[kind]}")
        if kind not in every:
            why = "no robot of the mission can have it; " if kind in KINDS else ""
            raise Refusal(f"--faults {kind!r}: {why}must be {ALL}, {NONE}, or some of {', '.join(every)}")
    for fault in faults:
        if fault.kind in lacking:
            raise Refusal(f"--fault {spelled(fault)}: needs {lacking[fault.kind]}")
    weather = Weather(options.loss, options.delay)
    if options.record is not None and options.seeds > 1:
        raise Refusal(f"--record {options.record}: records one run, without --seeds")
    return Plan(
        mission, kinds, faults, weather, options.seconds, options.world,
        signed=options.signed, monitored=options.monitor, record=options.record, text=text,
    )  # fmt: skip


def _check_world(options: argparse.Namespace) -> None:
    """Raises Refusal."""
    lacking = [package for package in NEEDED if options.world == "mujoco" and find_spec(package) is None]
    if lacking:
        raise Refusal(f"--world mujoco: {needs(lacking[0])}")


def _mission(options: argparse.Namespace) -> tuple[Mission, str]:
    """Return the mission, with the noise and the law of `options`, and its file. Raises Refusal."""
    try:
        text, source = read(options.mission)
        mission = parse_mission(text, source)
        if options.noise > 0.0:
            text = _noisy(text, options.noise, mission.collisions.noise)
            mission = parse_mission(text, source)
    except MissionError as error:
        raise Refusal(str(error)) from None
    if (why := why_unusable(options.law or mission.law.kind)) is not None:
        raise Refusal(f"{options.mission}: {why}")
    return mission if options.law is None else mission.under(options.law), text


def _noisy(text: str, noise: float, stated: float) -> str:
    """Return a mission's file with this noise of its robots [m], which it states."""
    document = tomlkit.parse(text)
    document.setdefault("simulated_robot", tomlkit.table())["position_noise"] = noise
    document.setdefault("collisions", tomlkit.table())["noise"] = max(noise, stated)
    return tomlkit.dumps(document)


def _options() -> argparse.ArgumentParser:
    what = (
        "Rehearse a mission: all its processes in one, on a virtual clock and a network in memory, with"
        f" faults. Rules are checked in every step ({', '.join(RULES)}); the same seed gives the same run."
    )
    flags = parser("rehearse", what, EXAMPLES)
    add_mission(flags)
    flags.add_argument("--seed", type=whole(0), default=0, help="the first seed (default 0)")
    flags.add_argument("--seeds", type=whole(1, MAX_SEEDS), default=1, help="how many seeds (default 1)")
    flags.add_argument(
        "--faults", metavar="KINDS",
        help=f"kinds to draw from, with commas: {ALL}, {NONE}, or some of {', '.join(KINDS)} (default: {ALL},"
        f" with --fault {NONE})",
    )  # fmt: skip
    flags.add_argument(
        "--fault", metavar="FAULT", action="append", default=[],
        help=f"a fault of every run, {FORM}, which without SECONDS does not end; repeatable",
    )  # fmt: skip
    flags.add_argument(
        "--loss",
        type=number(0.0, 0.95),
        default=0.0,
        help="share of messages that is always lost (default 0)",
    )
    flags.add_argument(
        "--delay", type=number(0.0, 2.0, "s"), default=0.0, help="delay of every link, always [s] (default 0)"
    )
    flags.add_argument(
        "--noise", type=number(0.0, 0.1, "m"), default=0.0,
        help="standard deviation of odometry, which the mission then states too [m] (default: the mission's)",
    )  # fmt: skip
    flags.add_argument(
        "--seconds", type=number(0.0, MAX_HORIZON, "s"), default=0.0,
        help=f"shortest run [s] (default: until the formation has settled after the last fault, which must"
        f" take at most {RECOVERY_TIME:.0f} s, among posts and walls {RECOVERY_TIME_AMONG_OBSTACLES:.0f} s)",
    )  # fmt: skip
    flags.add_argument(
        "--world",
        choices=("kinematic", "mujoco"),
        default="kinematic",
        help="robots that move as commanded, or physics with mass, motors, slip and contacts, without"
        " sensor faults; needs the extra physics (default: kinematic)",
    )
    flags.add_argument(
        "--signed", action="store_true",
        help="sign and verify orders, as where processes have certificates; needs the extra field",
    )  # fmt: skip
    flags.add_argument(
        "--monitor", action="store_true", help="run a monitor too; the run is the same with and without"
    )
    flags.add_argument(
        "--record", metavar="FILE", type=Path,
        help="have a monitor record the run, for report, replay and Foxglove; for one seed",
    )  # fmt: skip
    flags.add_argument("--jobs", type=whole(1, 1024), default=1, help="processes to use (default 1)")
    add_dask(flags)
    add_json(flags)
    return flags
