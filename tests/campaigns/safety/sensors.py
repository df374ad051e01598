"""Sensors that freeze, tremble or are late: how far do robots drive on, and do they go on afterwards?"""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import product
from typing import Any, NamedTuple

from formation.agent.simulated.faults import Fault
from formation.deploy.rehearsal.rehearsal import Plan, Verdict
from formation.deploy.rehearsal.rehearsal import run as rehearse
from formation.deploy.rehearsal.workers import each
from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.safety.part import Options, bar, reported
from tests.support.sensing import FAULTS, GRACE, MISSIONS, SOURCES, mission_of

TITLE = "Sensors that lie"
SEEDS, LASTS, BOUND = 5, 10.0, 0.1
"""Faults of each kind on each mission; length of a fault [s]; longest way after it [m]."""
ABOUT = f"""\
Rehearsals (`formation rehearse`). A random robot's sensor freezes, trembles around one place, or is late, at
a random moment on the way to its slot or in formation, for {LASTS:g} s; {SEEDS} times for each mission and
source. *Driven* is the true way from {GRACE:g} s after the robot first drove with the fault until that
ended, probes included. A robot must hold for positions older than half of its delay margin (law `field`:
that of gain 4 1/s at most, 0.2 s); its way counts where they are older. *Settled* is the time from the end
of the fault until the formation had settled, or where odometry counts from the start, until all robots ran
again."""


class Case(NamedTuple):
    """One kind of fault in one mission."""

    mission: str
    source: str
    kind: str
    size: float


def run(options: Options) -> Found:
    """Rehearse every case."""
    seeds, names = (2, MISSIONS[:2]) if options.quick else (SEEDS, MISSIONS)
    cases = [Case(name, source, *fault) for name, source, fault in product(names, SOURCES, FAULTS)]
    verdicts = each(_suffer, list(product(cases, range(seeds))), options.jobs)
    rows = [_row(case, [next(verdicts) for _ in range(seeds)]) for case in reported("sensors", cases)]
    driven = max(one["driven"] for one in rows)
    lost = sum(one["lost"] for one in rows)
    broken = sum(len(one["violations"]) for one in rows)
    wanted = "no robot drives 10 cm from 1 s after the fault on"
    bars = [
        bar(wanted, f"{100 * driven:.1f} cm", driven < BOUND),
        bar("all go on by themselves when the sensor is well", f"{lost} do not", lost == 0),
        bar("no rule of a rehearsal is broken", f"{broken} are", broken == 0),
    ]
    return {"faults": rows, "bars": bars}


def suffer(case: Case, seed: int) -> Verdict:
    """One fault of one robot at a random moment, under way to its slot or in formation."""
    mission, chance = mission_of(case.mission, case.source), random.Random(f"{case} {seed}")
    robot, since = chance.choice(mission.followers), round(chance.uniform(3.0, 20.0), 2)
    return rehearse(Plan(mission), seed, [Fault(robot, case.kind, case.size, since, LASTS)])


def _suffer(one: tuple[Case, int]) -> Verdict:
    return suffer(*one)


def _row(case: Case, tries: Sequence[Verdict]) -> dict[str, Any]:
    ends = [max(fault.since + fault.lasts for fault in one.faults) for one in tries]
    pairs = zip(tries, ends, strict=True)
    settled = [one.settled_at - end for one, end in pairs if one.settled_at is not None]
    return {
        **case._asdict(),
        "tries": len(tries),
        "driven": max(one.blind_path for one in tries),
        "settled": max(settled, default=0.0),
        "lost": len(tries) - len(settled),
        "violations": [f"seed {one.seed}: {bad.rule}: {bad.what}" for one in tries for bad in one.violations],
    }


def _words(case: dict[str, Any]) -> str:
    size, kind = case["size"], str(case["kind"])
    if kind == "tremble":
        return f"{kind} {1e6 * size:g} µm"
    return {"stale": f"late by {size:g} s", "backlog": f"later by {size:g} s/s"}.get(kind, kind)


def section(found: Found) -> str:
    names = [(one, f"{one['mission']} | {one['source']} | {_words(one)}") for one in found["faults"]]
    rows = [
        f"{name} | {one['tries']} | {100 * one['driven']:.1f} cm | {one['settled']:.1f} s | {one['lost']}"
        for one, name in names
    ]
    header = "mission | source | fault | tries | driven, most | settled after, most | not settled"
    broken = [f"- {name.replace(' | ', ', ')}: {bad}" for one, name in names for bad in one["violations"]]
    return "\n".join((table(header, rows), *broken))
