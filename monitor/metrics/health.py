"""A robot's health as one share: 1 when nothing is wrong.

Every fault leaves a share of it; the shares multiply, so two half faults are worse than one. The figure is
for display: it shows where to look first, and its words say why. Nothing is decided by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from formation.mission.robot import RobotSpec
from formation.monitor.metrics.events import LOST_SILENCE
from formation.monitor.metrics.feed import CLOCK_AGREES, freshness_limit
from formation.monitor.metrics.snapshot import KeyMetrics, RobotMetrics
from formation.topics import POSITION

MIN_RATE_SHARE = 0.9
"""Share of the promised rate that counts as full."""
LOSS_BEARABLE, LOSS_WEIGHT = 0.01, 3.0
"""Share of missed periods that is tolerated; health lost per share beyond it."""
CLOCK_OFF, REJECTED, SECOND_PUBLISHER, UNAVAILABLE = 0.6, 0.6, 0.3, 0.6
"""Health left to a robot with a wrong clock, with rejected messages, with a second publisher, and to one that
is unavailable."""
REJECTION_TIME = 10.0
"""How long a rejected message counts [s]."""
STATES = {"run": 1.0, "waiting": 0.7, "hold": 0.6, "stop": 0.5}
STATUSLESS_HEALTH = 0.5
"""Health of a robot that moves along but publishes no status."""


class Health(NamedTuple):
    """The health of one robot."""

    share: float
    """From 0 (lost) to 1 (no fault)."""
    why: str
    """The worst fault; empty if there is none."""


def health(name: str, metrics: RobotMetrics, spec: RobotSpec, *, contested: bool = False) -> Health:
    """Return the health of robot `name`; `contested` if a second publisher sends its positions."""
    share, worst, why = 1.0, 1.0, ""
    for part, reason in _parts(name, metrics, spec, contested=contested):
        share *= part
        if part < worst:
            worst, why = part, reason
    return Health(share, why)


def _parts(
    name: str, metrics: RobotMetrics, spec: RobotSpec, *, contested: bool
) -> Iterator[tuple[float, str]]:
    """Yield each fault: the share that it leaves, and its name."""
    if metrics.age is None:
        yield 0.0, "nothing received yet"
        return
    fresh = freshness_limit(spec.rate)
    lost = max(LOST_SILENCE, 2.0 * fresh)
    yield _down(metrics.age, fresh, lost), f"silent for {metrics.age:.1f} s"
    if metrics.rate is not None:
        rate_share = metrics.rate / (MIN_RATE_SHARE * spec.rate)
        yield min(rate_share, 1.0), f"{metrics.rate:.1f} Hz of {spec.rate:g} Hz"
    yield from _arriving(metrics.keys[POSITION.key(name)])
    if metrics.rejected_age is not None and metrics.rejected_age < REJECTION_TIME:
        yield REJECTED, "messages rejected"
    if contested:
        yield SECOND_PUBLISHER, "it has a second publisher"
    if metrics.unavailable:
        yield UNAVAILABLE, "unavailable: others go on without it"
    yield STATES.get(metrics.state, STATUSLESS_HEALTH), f"{metrics.state}: {metrics.reason}"


def _arriving(position: KeyMetrics) -> Iterator[tuple[float, str]]:
    if position.loss is not None:
        left = 1.0 - LOSS_WEIGHT * max(0.0, position.loss - LOSS_BEARABLE)
        yield max(left, 0.1), f"{position.loss:.0%} of its positions missed"
    if position.clock is not None and not CLOCK_AGREES[0] <= position.clock <= CLOCK_AGREES[1]:
        yield CLOCK_OFF, f"its clock is {position.clock:.1f} s off"


def _down(value: float, good: float, bad: float) -> float:
    """Return 1 up to `good`, then falling to 0 at `bad`."""
    return min(max((bad - value) / (bad - good), 0.0), 1.0)
