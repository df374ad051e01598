"""Missions without faults, with noise, delay and slip: does a robot ever hold by itself?"""

from __future__ import annotations

from functools import partial
from importlib.util import find_spec
from itertools import product
from typing import Any, NamedTuple

from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.fleet import WorldName
from formation.deploy.rehearsal.rehearsal import Plan, Verdict
from formation.deploy.rehearsal.rehearsal import run as rehearse
from formation.deploy.rehearsal.workers import each
from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.safety.part import Options, bar, reported
from tests.support.sensing import MISSIONS, mission_of, noisy, resting

TITLE = "An hour without faults"
SECONDS, NOISE, DELAY = 3600.0, 0.005, 0.1
"""Length of each run [s]; noise of own positions [m]; delay of every link [s]."""
ABOUT = f"""\
Rehearsals of each shipped mission for an hour with {1000 * NOISE:.0f} mm of noise (standard deviation per
axis, which the mission states) and {1000 * DELAY:.0f} ms of delay on every link; the same behind a leader at
rest; and with mass and wheels that slip (MuJoCo: that delay, the noise of its own sensors, positions from
outside, since after minutes on slipping wheels odometry is wrong by more than the robots' distances). How
often did a robot hold by itself after it had begun to drive?"""


class Case(NamedTuple):
    """One run."""

    mission: str
    world: WorldName
    at_rest: bool


def run(options: Options) -> Found:
    seconds, names = (60.0, MISSIONS[:2]) if options.quick else (SECONDS, (*MISSIONS, "posts"))
    worlds: list[WorldName] = ["kinematic", "mujoco"] if find_spec("mujoco") else ["kinematic"]
    kinds = [*product(worlds, (False,)), ("kinematic", True)]
    cases = [Case(name, *kind) for kind, name in product(kinds, names)]
    verdicts = each(partial(undisturbed, seconds), cases, options.jobs)
    rows = [_row(one, seconds, next(verdicts)) for one in reported("quiet", cases)]
    holds = sum(len(one["holds"]) for one in rows)
    broken = sum(len(one["others"]) for one in rows)
    bars = [
        bar(f"no false hold in {seconds:.0f} s of each mission", f"{holds}", holds == 0),
        bar("no other rule of a rehearsal is broken", f"{broken}", broken == 0),
    ]
    return {"runs": rows, "bars": bars}


def undisturbed(seconds: float, case: Case) -> Verdict:
    """A mission with noise and delay, and without faults."""
    source = "odometry" if case.world == "kinematic" else "external"
    mission = noisy(mission_of(case.mission, source), NOISE)
    chosen = resting(mission) if case.at_rest else mission
    return rehearse(Plan(chosen, weather=Weather(delay=DELAY), seconds=seconds, world=case.world), 1, ())


def _row(case: Case, seconds: float, verdict: Verdict) -> dict[str, Any]:
    found = verdict.violations
    return {
        **case._asdict(),
        "seconds": seconds,
        "nearest": verdict.nearest,
        "holds": [f"{one.time:.1f} s: {one.robot}: {one.what}" for one in found if one.rule == "hold"],
        "others": [f"{one.time:.1f} s: {one.rule}: {one.what}" for one in found if one.rule != "hold"],
    }


def section(found: Found) -> str:
    rows = [
        f"{one['mission']} | {one['world']} | {'at rest' if one['at_rest'] else 'as shipped'} | "
        f"{one['seconds']:.0f} s | {100 * one['nearest']:.0f} cm | {'; '.join(one['holds']) or 'none'} | "
        f"{'; '.join(one['others']) or 'none'}"
        for one in found["runs"]
    ]
    header = "mission | world | leader | time | nearest bodies | false holds | other rules broken"
    return table(header, rows)
