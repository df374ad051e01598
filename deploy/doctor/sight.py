"""Examine a range scanner, and what a robot that corrects its pose by its neighbours sees of them."""

from __future__ import annotations

from collections.abc import Iterator
from statistics import fmean, median

from formation.control.tracker import FRESH_PERIODS
from formation.deploy.doctor.facts import Examination, Facts, Finding, ScanMessage, Stream
from formation.deploy.doctor.robot import MAX_RATE_SHARE, MIN_RATE_SHARE, stream_findings
from formation.mission.robot import ScanSpec
from formation.protocol.reasons import Code
from formation.protocol.status import AgentStatus, Sight

MAX_SWEEP_DIFFERENCE = 0.25
"""Greatest difference between the duration of a sweep and what the rate of scans tells, as a share."""
SEARCHES = (
    "is it on its start pose, to 5 cm and 3°? are they in sight within 2 m, all scanners at one height, and"
    " `scan` and `seen` in the mission right?"
)


def _scanner(facts: Facts) -> Iterator[Finding]:
    spec = None if facts.leads else facts.mission.robots[facts.robot]
    if spec is None or spec.scanner == "none" or facts.router_error:
        return
    if facts.scan is not None:
        faults = list(stream_findings(facts, "scan", "the range scan", facts.scan, _rates(spec.scan)))
        yield from faults or _sweep(facts.robot, spec.scan, facts.scans, facts.scan)
    if facts.scans and all(one.hits == 0 for one in facts.scans):
        yield Finding(
            "scan-empty",
            f"no beam of {len(facts.scans)} range scans came back",
            "does its head turn, is its window free and clean? else nothing is within its range",
        )
    if facts.agent is not None and facts.agent.scan_fault is not None:
        yield Finding(
            "scan-refused",
            f"its agent does not believe its range scans: {facts.agent.scan_fault}",
            "see docs/guide/range-scanners.md, scans that are not believed",
        )


def _rates(scan: ScanSpec) -> tuple[float, float, float]:
    """Return the wanted rate of scans, and the least and the greatest that are normal [Hz]."""
    if scan.scanner is None:
        return scan.rate, MIN_RATE_SHARE * scan.rate, MAX_RATE_SHARE * scan.rate
    least, most = scan.scanner.least_rate, scan.scanner.most_rate
    return scan.rate, min(least, MIN_RATE_SHARE * scan.rate), max(most, MAX_RATE_SHARE * scan.rate)


def _sweep(robot: str, scan: ScanSpec, scans: tuple[ScanMessage, ...], stream: Stream) -> Iterator[Finding]:
    """Compare the sweep that the agent uses with the time between scans."""
    if not scans or len(stream.gaps) < FRESH_PERIODS:
        return
    period, used = median(stream.gaps), abs(scan.signed_sweep(_stated(scans)))
    expected = period * median(one.turn for one in scans)
    if used == 0.0 or abs(used - expected) <= MAX_SWEEP_DIFFERENCE * expected:
        return
    if scan.sweep is None:
        yield Finding(
            "scan-sweep",
            f"its range scans state a sweep of {used:.3g} s, and come every {period:.3g} s",
            f"set the scanner of {robot} in the mission: `model` or `sweep` of `scan`",
        )
    else:
        yield Finding(
            "scan-sweep",
            f"the mission says that a sweep takes {used:.3g} s, but range scans come every {period:.3g} s",
            f"correct `sweep` of {robot}'s `scan`, or its `model`",
        )


def _stated(scans: tuple[ScanMessage, ...]) -> float:
    return median(one.sweep for one in scans)


def _scanner_seen(facts: Facts) -> str:
    seen = []
    if facts.scan is not None and facts.scan.received:
        seen.append(f"{facts.scan.rate:.3g} Hz")
    if facts.scans:
        lost = 1.0 - fmean(one.hits / one.beams for one in facts.scans)
        stated = _stated(facts.scans)
        seen.append(f"{facts.scans[-1].beams} beams, {100.0 * lost:.0f} % without a range")
        seen.append(f"states a sweep of {stated:.3g} s" if stated > 0.0 else "states no sweep")
        sweep = facts.mission.robots[facts.robot].scan.signed_sweep(stated)
        if sweep != stated:
            seen.append(f"its agent takes {sweep:.3g} s")
    elif facts.scan is None and facts.agent is not None and "scan" in facts.agent.age:
        seen.append(f"newest range scan {facts.agent.age['scan']:.1f} s old")
    return ", ".join(seen)


def _sight(facts: Facts) -> Iterator[Finding]:
    status, landmarks = facts.agent, _landmarks(facts)
    if status is None or status.sight is None or not landmarks:
        return
    names = ", ".join(landmarks)
    contradicted = status.reason.code is Code.SIGHT_CONTRADICTED
    if set(landmarks) <= set(status.sight_lost):
        goes = "and it stands" if status.sight is Sight.SEARCHING else "and it uses odometry"
        ages = [status.sight_age[name] for name in landmarks if name in status.sight_age]
        since = f" for {min(ages):.0f} s" if ages else ""
        yield Finding(
            "sight-none", f"its scanner has seen none of {names}{since}, {goes}", _remedy(contradicted)
        )
    elif status.sight is Sight.SEARCHING:
        yield Finding(
            "sight-searching",
            f"it stands until it sees where it is: {_each(status, landmarks)}",
            _remedy(contradicted),
        )


def _remedy(contradicted: bool) -> str:
    if contradicted:
        return "put it and its neighbours on their start poses, and restart bring-up and agent"
    return SEARCHES


def _sight_seen(facts: Facts) -> str:
    status, landmarks = facts.agent, _landmarks(facts)
    if status is None or (status.sight is None and landmarks):
        return ""
    if not landmarks:
        seen = ["uses odometry: no neighbour corrects it"] if _must_see(facts) else []
    else:
        seen = [f"{status.sight}: {_each(status, landmarks)}"] if status.sight is not None else []
    if facts.seen_by:
        seen.append(f"seen by {', '.join(facts.seen_by)}")
    return "; ".join(seen)


def _each(status: AgentStatus, landmarks: tuple[str, ...]) -> str:
    """Return what the robot sees of each neighbour that corrects its pose."""
    parts = []
    for name in landmarks:
        age, deviation = status.sight_age.get(name), status.sight_deviation.get(name)
        if name in status.sight_lost or age is None:
            parts.append(f"{name} not seen" + ("" if age is None else f" for {age:.1f} s"))
        else:
            precise = "" if deviation is None else f" to {100.0 * deviation:.1f} cm"
            parts.append(f"{name}{precise}, {age:.1f} s ago")
    return "; ".join(parts)


def _must_see(facts: Facts) -> bool:
    return not facts.leads and facts.mission.robots[facts.robot].measurement == "scan"


def _landmarks(facts: Facts) -> tuple[str, ...]:
    return () if facts.leads else facts.mission.landmarks_of(facts.robot)


SCANNER = Examination("scanner", _scanner, _scanner_seen)
SIGHT = Examination("sight", _sight, _sight_seen)
