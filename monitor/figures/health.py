"""How well a robot is heard and does, as one figure: full like a battery when there is nothing to say.

Every doubt takes its share; they multiply, so two half troubles are worse than one. The figure is for the
eye: it says where to look first, and its words say why. Nothing is decided by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from formation.robot_spec import RobotSpec
from formation.topics import POSITION
from monitor.figures.events import LOST, READONLY
from monitor.figures.feed import CLOCK_AGREES, freshness_limit
from monitor.figures.snapshot import KeyFigures, RobotFigures

RATE_KEPT = 0.9
"""Share of the promised rate that is as good as all of it."""
LOSS_BEARABLE, LOSS_WEIGHT = 0.01, 3.0
"""Share of missed periods that means nothing; how much health each further one takes."""
CLOCK_OFF, REJECTED, SECOND_VOICE, ASIDE = 0.6, 0.6, 0.3, 0.6
"""What is left of the health of a robot with a wrong clock, with rejected messages, with a double, of one
that does not follow."""
LATELY = 10.0
"""So long ago a rejected message still counts [s]."""
STATES = {"run": 1.0, "waiting": 0.7, "hold": 0.6, "stop": 0.5}
UNHEARD = 0.5
"""Health of a robot that moves along but says nothing of itself."""


class Health(NamedTuple):
    """One robot's."""

    share: float
    """From 0, lost, to 1, all is well."""
    why: str
    """The worst of what is wrong; empty where nothing is."""


def health(name: str, figures: RobotFigures, spec: RobotSpec, *, contested: bool = False) -> Health:
    """The health of robot `name`; `contested` if a second voice speaks for it."""
    share, worst, why = 1.0, 1.0, ""
    for part, reason in _parts(name, figures, spec, contested=contested):
        share *= part
        if part < worst:
            worst, why = part, reason
    return Health(share, why)


def _parts(
    name: str, figures: RobotFigures, spec: RobotSpec, *, contested: bool
) -> Iterator[tuple[float, str]]:
    """Each doubt: what it leaves, and what it is called."""
    if figures.age is None:
        yield 0.0, "not heard of yet"
        return
    fresh = freshness_limit(spec.rate)
    lost = max(LOST, 2.0 * fresh)
    yield _down(figures.age, fresh, lost), f"silent for {figures.age:.1f} s"
    if figures.rate is not None:
        kept = figures.rate / (RATE_KEPT * spec.rate)
        yield min(kept, 1.0), f"{figures.rate:.1f} Hz of {spec.rate:g} Hz"
    yield from _arriving(figures.keys[POSITION.key(name)])
    if figures.rejected_age is not None and figures.rejected_age < LATELY:
        yield REJECTED, "messages rejected"
    if contested:
        yield SECOND_VOICE, "a second voice speaks for it"
    if figures.aside:
        yield ASIDE, "does not follow: others go on without it"
    state = figures.state.removeprefix(READONLY)
    yield STATES.get(state, UNHEARD), f"{state}: {figures.reason}"


def _arriving(position: KeyFigures) -> Iterator[tuple[float, str]]:
    if position.loss is not None:
        left = 1.0 - LOSS_WEIGHT * max(0.0, position.loss - LOSS_BEARABLE)
        yield max(left, 0.1), f"{position.loss:.0%} of its positions missed"
    if position.clock is not None and not CLOCK_AGREES[0] <= position.clock <= CLOCK_AGREES[1]:
        yield CLOCK_OFF, f"its clock is {position.clock:.1f} s off"


def _down(value: float, good: float, bad: float) -> float:
    """1 up to `good`, then falling to 0 at `bad`."""
    return min(max((bad - value) / (bad - good), 0.0), 1.0)
