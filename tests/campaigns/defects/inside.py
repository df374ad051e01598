"""What runs beside a copy of the product: plan after plan, until a rule breaks; a line of JSON for each.

python -m tests.campaigns.defects.inside NUMBER ..., with the copy first on PYTHONPATH.
"""

from __future__ import annotations

import cmath
import contextlib
import io
import json
import math
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import formation
from formation.deploy import rehearse as command
from formation.deploy.cli import main as cli
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.faults import INSIDERS, KINDS, parse
from formation.deploy.rehearsal.rehearsal import Plan as Rehearsed
from formation.deploy.rehearsal.rehearsal import rehearse
from formation.deploy.rehearsal.workers import each
from formation.deploy.testing.rehearsed import RehearsedFleet
from formation.mission.file import parse as parse_mission
from formation.mission.file import read
from tests.campaigns.defects.plan import Plan
from tests.campaigns.defects.plans import PLANS

Broken = dict[str, Any]


def main(words: Sequence[str]) -> None:
    """Say which formation this is, then try the plans of these numbers."""
    print(json.dumps({"formation": formation.__file__}), flush=True)
    for number, broken in zip(words, each(run, [PLANS[int(word)] for word in words]), strict=True):
        print(json.dumps({"plan": int(number), "broken": broken}), flush=True)
        if broken:
            return


def run(plan: Plan) -> list[Broken]:
    """The rules that `plan` breaks."""
    try:
        if plan.told:
            return told(plan)
        with tempfile.TemporaryDirectory(prefix="defect-") as folder:
            return rehearsed(plan, Path(folder) / "run.mcap" if plan.recorded else None)
    except Exception as error:  # noqa: BLE001 - whatever it is, the defect showed
        return [broken_by("exception", f"{type(error).__name__}: {error}")]


def rehearsed(plan: Plan, path: Path | None) -> list[Broken]:
    """As ``formation rehearse`` does, and then ``formation replay --verify`` of its recording."""
    text, source = read(plan.source)
    if plan.noise:
        text = command._noisy(text, plan.noise, parse_mission(text, source).collisions.noise)
    mission = parse_mission(text, source)
    every = tuple(kind for kind in KINDS if plan.signed or kind not in INSIDERS)
    verdict = rehearse(
        Rehearsed(
            mission,
            every if plan.kinds == ("all",) else plan.kinds,
            tuple(parse(fault, mission) for fault in plan.faults),
            Weather(plan.loss, plan.delay),
            plan.seconds,
            signed=plan.signed,
            record=path,
            text=text,
        ),
        plan.seed,
    )
    broken = [one._asdict() for one in verdict.violations]
    if path is not None and not broken:
        broken = [*verified(path, "replay", "--verify"), *verified(path, "report")]
    return broken


def verified(path: Path, *words: str) -> list[Broken]:
    """What a command says of the recording at `path`, if it fails."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        try:
            code: Any = cli([words[0], str(path), *words[1:]])
        except SystemExit as end:
            code = end.code
    what = " ".join(said.getvalue().split())[-200:]
    return [broken_by(words[0], f"exit code {code}: {what}")] if code else []


def told(plan: Plan) -> list[Broken]:
    """Give the orders of `plan`; then the formation must settle."""
    with RehearsedFleet(
        plan.source, seed=plan.seed, faults=plan.faults, loss=plan.loss, delay=plan.delay,
        signed=plan.signed, strict=False,
    ) as fleet:  # fmt: skip
        for one in plan.told:
            fleet.run(max(0.0, one.at - fleet.now))
            if one.do in {"cut", "heal", "kill", "start"}:
                getattr(fleet, one.do)(**one.what)
                continue
            outcome = fleet.order(one.do, **one.what)
            if not fleet.violations and (outcome.missing or not outcome.obeyed):
                answers = {name: reply.reply.reason for name, reply in outcome.answers.items()}
                what = f"{one.do}: missing {outcome.missing}, answers {answers}"
                return [broken_by("order", what, fleet.now)]
        fleet.run(max(0.0, plan.seconds - fleet.now))
        try:
            fleet.run_until_settled()
        except AssertionError as error:
            if not fleet.violations:
                return [broken_by("formation", str(error), fleet.now)]
        return [one._asdict() for one in fleet.violations] or disobeyed(plan, fleet)


def disobeyed(plan: Plan, fleet: RehearsedFleet) -> list[Broken]:
    """Where the leader and the robots end with something else than the newest orders."""
    newest = {one.do: one.what for one in plan.told}
    leader, agents = fleet._fleet.leading, [agent for agent, _ in fleet._fleet.agents.values()]
    shape, wanted = newest.get("shape", {}).get("shape", fleet.mission.first_shape), leader.plan.wanted
    turned = cmath.rect(1.0, math.radians(newest.get("rotate", {}).get("degrees", 0.0)))
    found = []
    if dict(wanted.mix) != {shape: 1.0}:
        found.append(f"shape {wanted.mix}, ordered {shape}")
    if abs(cmath.rect(1.0, wanted.rotation) - turned) > 1e-6:
        found.append(f"rotation {math.degrees(wanted.rotation):.1f}°, ordered {newest['rotate']}")
    if wanted.scale != newest.get("scale", {}).get("factor", 1.0):
        found.append(f"scale {wanted.scale}, ordered {newest.get('scale')}")
    if tuned := newest.get("tune"):
        gains = {(agent.tuning.state.k_p, agent.tuning.state.k_i) for agent in agents}
        found += [f"gains {gains}, ordered {tuned}"] * (gains != {(tuned["k_p"], tuned["k_i"])})
    if not {"speed", "hold", "stop"} & newest.keys() and leader.route_time < 0.5 * fleet.now:
        found.append(f"{leader.route_time:.1f} s on its route after {fleet.now:.1f} s")
    return [broken_by("order", one, fleet.now) for one in found]


def broken_by(rule: str, what: str, time: float = 0.0) -> Broken:
    """A rule beside those of the judge that is broken at `time` [s]."""
    return {"rule": rule, "time": time, "robot": "", "what": what[:300]}


if __name__ == "__main__":
    main(sys.argv[1:])
