"""Check that the clocks agree: a receiver computes a position's age from its sender's time."""

from __future__ import annotations

from collections.abc import Iterator

from formation.control.tracker import FRESH_PERIODS
from formation.deploy.doctor.facts import Examination, Facts, Finding, Stream

CHRONY_LIMIT = 0.02
"""Offset from NTP time from which on it is reported [s]."""


def look(facts: Facts) -> Iterator[Finding]:
    """Yield findings from received stamps, the agent's report on neighbours' stamps, and chrony."""
    for what, stream in _streams(facts):
        offset = behind(stream)
        if offset is not None and abs(offset) > limit(facts):
            yield Finding(
                "clock-offset",
                f"{what} is stamped {abs(offset):.3g} s {'ago' if offset > 0 else 'ahead'}, by this clock",
                "let chrony run on both machines: chronyc tracking",
            )
    for name, age in (facts.agent.clock if facts.agent else {}).items():
        yield Finding(
            "clock-doubted",
            f"its agent does not believe the stamps of {name}: {age:.3f} s old when they came",
            "let chrony run on both machines: chronyc tracking",
        )
    if facts.chrony is not None and not facts.chrony.synchronised:
        yield Finding(
            "clock-unsynchronised",
            "chrony has found no time server that it trusts",
            "see chronyc sources; the desk may be the server of the field",
        )
    elif facts.chrony is not None and abs(facts.chrony.offset) > CHRONY_LIMIT:
        yield Finding(
            "clock-not-settled",
            f"this machine's clock is {abs(facts.chrony.offset):.3g} s from its time server's",
            "wait until chronyc tracking says less, or chronyc makestep while nothing moves",
        )


def well(facts: Facts) -> str:
    """Return the largest difference seen."""
    offsets = [abs(offset) for _, stream in _streams(facts) if (offset := behind(stream)) is not None]
    seen = [f"stamps within {max(offsets) * 1e3:.0f} ms"] if offsets else []
    if facts.chrony is not None:
        seen.append(f"chrony within {abs(facts.chrony.offset) * 1e3:.2g} ms")
    return ", ".join(seen)


def behind(stream: Stream) -> float | None:
    """Return how far a sender's clock is behind ours [s]: the least one seen, as delays only add to it."""
    return min((one.behind for one in stream.received), default=None)


def limit(facts: Facts) -> float:
    """Return half the age at which a position counts as stale [s].

    An agent takes a larger offset for a long delay and extrapolates too far: only the doctor reports that.
    """
    return 0.5 * FRESH_PERIODS * facts.period


def _streams(facts: Facts) -> Iterator[tuple[str, Stream]]:
    for what, stream in (
        ("odometry", facts.odometry),
        ("the external pose", facts.pose),
        ("its position", facts.position),
        ("its status", facts.status),
    ):
        if stream is not None:
            yield what, stream


CLOCKS = Examination("clock", look, well)
