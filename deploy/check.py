"""`formation check`: analyse a mission before anything moves."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from formation.deploy.arguments import add_json, add_mission, parser, print_result, read_driven
from formation.deploy.refusal import refuse_errors
from formation.deploy.terminal.bar import message_if_slow, warn_if_slow
from formation.mission.model import Mission
from formation.simulation.compiled import LawError
from formation.slots.geofence import Area
from formation.stability.analysis import Analysis, analyse
from formation.stability.certificate import Certificate, worst_curve
from formation.stability.losses import Loss, losses
from formation.transport.wiring import Cause, cause, partners

EXAMPLES = """\
  formation check six_robots
  formation check my_mission.toml --law paper --json

Exit code 0: no problem found; 1: it cannot work, for the problems named; 2: it is no mission.
"""


def main(arguments: Sequence[str]) -> int:
    """Check a mission; return the exit code."""
    flags = parser("check", "Check a mission before anything moves.", EXAMPLES)
    add_mission(flags)
    add_json(flags)
    options = flags.parse_args(arguments)
    mission = read_driven(options.mission, options.law)
    warn_if_slow()
    text = "checking; with many robots, and the first time, this takes ten seconds and more"
    with message_if_slow(text), refuse_errors(LawError):
        found = analyse(mission)
    result = {"mission": mission.name, **found.as_json(), "bounds": bounds(mission), "links": links(mission)}
    print_result(options, words(mission, found), lambda: {**result, "losses": _losses_as_json(mission)})
    return 0 if found.ok else 1


def bounds(mission: Mission) -> dict[str, Any]:
    """Return the bounds of robots [m; world frame], and whether the mission sets them."""
    area = Area.of(mission)
    x, y = [area.x_min, area.x_max], [area.y_min, area.y_max]
    return {"x": x, "y": y, "default": mission.bounds is None}


def words(mission: Mission, found: Analysis) -> str:
    """Return the analysis for people."""
    lines = [*_summary(mission, found), "", *_robots(mission, found), "", *_losses(mission)]
    for title, findings in (("problem", found.problems), ("warning", found.warnings)):
        for finding in findings:
            lines += ["", f"{title}: {finding}"]
    return "\n".join(lines)


def _summary(mission: Mission, found: Analysis) -> Iterator[str]:
    verdict = "no problem found" if found.ok else "it cannot work"
    if found.warnings:
        verdict += f", {len(found.warnings)} warning{'' if len(found.warnings) == 1 else 's'}"
    deepest = max((hops for hops in found.depth.values() if hops is not None), default=0)
    yield f"{mission.name}, {found.law} law: {verdict}"
    hops = f"{deepest} hop{'' if deepest == 1 else 's'} to the leader at most"
    yield f"  graph            {found.robots} robots, {found.edges} edges, {hops}"
    yield f"  stable           {'yes' if found.stable else 'NO'}; slowest mode {found.slowest_mode:+.3g} 1/s"
    yield from _proven(found.certificate)
    settles = f"not within {mission.simulation.horizon:g} s from the mission's own starts"
    if found.settling_time_estimate is not None:
        settles = f"after {found.settling_time_estimate:.1f} s from the mission's own starts, simulated"
    yield f"  settles          {settles}"
    margin = "any delay"
    if math.isfinite(found.delay_margin):
        margin = f"{found.delay_margin * 1e3:.0f} ms, if a robot's own position is as late as its neighbours'"
    yield f"  delay margin     {margin}"
    yield f"  eigenvalues      {_eigenvalues(found.eigenvalues)}"
    source = "by default" if mission.bounds is None else "as the mission says"
    yield f"  bounds           {Area.of(mission).words}, {source}"
    yield f"  links            {_links(mission)}"


def _proven(found: Certificate) -> Iterator[str]:
    """Yield what is proven, as docs/theory/convergence.md has it."""
    if found.convergence == "every start":
        yield "  proven           comes into formation from every start (theorem 1), while the leader drives"
        yield "                   straight and robots obey at once, without filter and ramp"
    elif found.convergence == "near formation":
        yield f"  proven           stable near formation; not from every start: {found.broken[0]}"
    if (worst := worst_curve(found)) is not None:
        name, error = worst
        yield f"  on curves        off by {1e3 * error:.2g} mm at most ({name}), with ideal bodies"


def links(mission: Mission) -> dict[str, dict[Cause, list[str]]]:
    """Return the processes with which each follower's agent is linked, by cause; without the monitor."""
    found: dict[str, dict[Cause, list[str]]] = {}
    for name in mission.followers:
        found[name] = {one: [] for one in Cause}
        for other in partners(mission, name):
            if (why := cause(mission, name, other)) is not None:
                found[name][why].append(other)
    return found


def _links(mission: Mission) -> str:
    """Return the links of the agent that has the most."""
    each = links(mission)
    name = max(each, key=lambda one: sum(map(len, each[one].values())))
    graph, avoid, leader = (len(each[name][why]) for why in (Cause.GRAPH, Cause.AVOID, Cause.LEADER))
    text = f"{graph + avoid + leader} per agent at most ({name}): {graph} by the graph"
    if leader:
        text += f", {leader} for standbys or a leader that waits"
    return text + (f", {avoid} for `avoid`" if avoid else "")


def _robots(mission: Mission, found: Analysis) -> Iterator[str]:
    width = max(len(name) for name in ("robot", *mission.names)) + 2
    yield f"  {'robot':<{width}}{'hops':<6}{'error per leader speed':<24}measures"
    for name in mission.names:
        peak = found.amplification.get(name)
        grown = "-" if peak is None else f"{peak:.3g} s" if math.isfinite(peak) else "without end"
        hops = found.depth[name]
        yield (f"  {name:<{width}}{'none' if hops is None else hops:<6}{grown:<24}{_measured(mission, name)}")


def _measured(mission: Mission, name: str) -> str:
    spec = mission.robots[name]
    others = ", ".join(spec.neighbours) or "none: it leads"
    return others + (f", or else {', '.join(spec.fallback_neighbours)}" if spec.fallback_neighbours else "")


def _losses(mission: Mission) -> Iterator[str]:
    """Yield the effect of losing each single robot: robots that hold, and robots that use fallbacks."""
    found = losses(mission)
    leader = found.pop(mission.leader)
    if not any(loss.holding for loss in found.values()):
        yield "  any single follower may be lost: the others go on"
    else:
        replaceable = [name for name, loss in found.items() if not loss.holding]
        if replaceable:
            yield f"  {_joined_with_or(replaceable)} may be lost: the others go on"
    for name, loss in found.items():
        sentences = _loss_in_words(mission, loss)
        if sentences:
            yield f"  {name} lost: {sentences}"
    if mission.standbys:
        first = next(iter(mission.standbys))
        yield f"  {mission.leader} lost: {first} leads within about {mission.takeover:g} s"
    else:
        yield f"  {mission.leader} lost: {_loss_in_words(mission, leader)}, for there is no standby"


def _loss_in_words(mission: Mission, loss: Loss) -> str:
    sentences = []
    if loss.holding:
        all_others = len(loss.holding) >= len(mission.followers) - 1 and len(loss.holding) > 1
        sentences.append(
            "all others hold" if all_others else
            f"{', '.join(loss.holding)} {'holds' if len(loss.holding) == 1 else 'hold'}"
        )  # fmt: skip
    sentences += [f"{name} goes on by {', '.join(others)}" for name, others in loss.instead.items()]
    return "; ".join(sentences)


def _joined_with_or(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def _losses_as_json(mission: Mission) -> dict[str, Any]:
    """Return the losses by lost robot; for the leader also its replacement, None if there is none."""
    found: dict[str, Any] = {
        name: {"hold": list(loss.holding), "instead": {one: list(by) for one, by in loss.instead.items()}}
        for name, loss in losses(mission).items()
    }
    successor = next(iter(mission.standbys), None)
    found[mission.leader] |= {"successor": successor} | ({"hold": []} if successor else {})
    return found


def _eigenvalues(values: Sequence[complex]) -> str:
    """Return the distinct eigenvalues, slowest first, with their counts; a conjugate pair as one."""
    counts: dict[str, int] = {}
    for value in sorted(values, key=lambda value: (-value.real, abs(value.imag), value.imag)):
        if value.imag < -1e-9:
            continue
        text = f"{value.real:.3g}" + (f" ± {value.imag:.3g}i" if value.imag > 1e-9 else "")
        counts[text] = counts.get(text, 0) + 1
    shown = [text if times == 1 else f"{text} ({times} times)" for text, times in counts.items()]
    return ", ".join(shown[:6]) + (f" and {len(shown) - 6} more" if len(shown) > 6 else "") + " 1/s"
