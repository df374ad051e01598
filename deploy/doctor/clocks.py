"""Do the clocks agree? Positions carry their sender's time, so that a receiver knows how old they are."""

from __future__ import annotations

from collections.abc import Iterator

from deploy.doctor.facts import Examination, Facts, Finding, Stream
from formation.neighbour import FRESH_PERIODS

CHRONY_LIMIT = 0.02
"""Offset from NTP time that deserves a word [s]."""
CLOCK = "clock "
"""How keys of a status begin that tell of a neighbour whose stamps are not believed."""


def look(facts: Facts) -> Iterator[Finding]:
    """Stamps of what was heard, what the agent says of its neighbours' stamps, and chrony's own word."""
    for what, stream in _streams(facts):
        offset = behind(stream)
        if offset is not None and abs(offset) > limit(facts):
            yield Finding(
                "clock-offset",
                f"{what} is stamped {abs(offset):.3g} s {'ago' if offset > 0 else 'ahead'}, by this clock",
                "let chrony run on both machines: chronyc tracking",
            )
    for key, value in (facts.said.values if facts.said else {}).items():
        if key.startswith(CLOCK):
            yield Finding(
                "clock-doubted",
                f"its agent does not believe the stamps of {key.removeprefix(CLOCK)}: {value}",
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
    """The largest difference seen."""
    offsets = [abs(offset) for _, stream in _streams(facts) if (offset := behind(stream)) is not None]
    seen = [f"stamps within {max(offsets) * 1e3:.0f} ms"] if offsets else []
    if facts.chrony is not None:
        seen.append(f"chrony within {abs(facts.chrony.offset) * 1e3:.2g} ms")
    return ", ".join(seen)


def behind(stream: Stream) -> float | None:
    """How far a sender's clock is behind ours [s]: the least of what was seen, for the way here only adds."""
    return min((one.behind for one in stream.heard), default=None)


def limit(facts: Facts) -> float:
    """Half the age at which a position counts as stale [s].

    An agent takes more than this for a long way, and carries positions too far: nobody but the doctor tells.
    """
    return 0.5 * FRESH_PERIODS * facts.period


def _streams(facts: Facts) -> Iterator[tuple[str, Stream]]:
    for what, stream in (
        ("odometry", facts.odometry),
        ("the pose from outside", facts.pose),
        ("its position", facts.position),
        ("its status", facts.status),
    ):
        if stream is not None:
            yield what, stream


CLOCKS = Examination("clock", look, well)
