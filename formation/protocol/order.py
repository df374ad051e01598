"""The leader's order, attached to positions.

The leader attaches an order to its own position; every agent relays the newest it has received, unchanged,
on its own position, so along the spanning tree it reaches all robots. Its `beat` counts the leader's
periods: as long as it rises, the leader is alive.

In a mission with certificates the leader signs each order. The order is then transmitted as the very text
that was signed, with its signature, so that every robot verifies the bytes that it decodes.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from formation.control.plane import rotation
from formation.control.unicycle import along
from formation.protocol.json_message import Count, Id, JsonMessage, Name, Scale

LEADER_TIMEOUT_SECONDS = 1.0
"""Silence of the leader's beat after which it counts as dead, and all robots stand still [s]."""

DRIVE_TIMEOUT_SECONDS = 0.3
"""Time for which a driver's velocity counts, from the reply of the leader that it answers [s]."""

DRIVEN_ROUTE = "driven"
"""Id of the route of a leader that is driven by hand."""
MAX_MOTION_SECONDS = 1.0
"""Longest time by which the leader's velocity is told ahead, and extrapolated [s]."""

Mode = Literal["hold", "run", "stop"]
Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Share = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=1.0)]
MIN_GAIN, MAX_GAIN = 1e-3, 1e3
"""Bounds of a gain that can be ordered; k_i may also be 0."""
Proportional = Annotated[float, Field(allow_inf_nan=False, ge=MIN_GAIN, le=MAX_GAIN)]
Integral = Annotated[float, Field(allow_inf_nan=False, ge=0.0, le=MAX_GAIN)]


class Slots(JsonMessage):
    """Slots during a transition or a rotation: `formation.slots.shape.PlacedShape`."""

    mix: dict[Name, Share] = Field(min_length=1, max_length=8)
    """Each shape's share; they sum to 1."""
    rotation: Number = 0.0
    """Counter-clockwise [rad; world frame]."""
    scale: Scale = 1.0


class Place(JsonMessage):
    """The leader's position."""

    x: Number
    y: Number
    """[m; world frame]"""
    heading: Number
    """Direction of travel [rad; world frame]."""


class Steady(JsonMessage):
    """A velocity that turns at an even rate."""

    x: Number
    y: Number
    """[m/s; world frame]"""
    turn_rate: Number = 0.0
    """[rad/s]"""

    def after(self, time: float) -> complex:
        """Velocity [m/s; world frame] `time` [s] later."""
        return complex(self.x, self.y) * rotation(self.turn_rate * time)


class Motion(Steady):
    """The leader's velocity from its newest step on, and its next change."""

    until: Annotated[float, Field(ge=0.0, le=MAX_MOTION_SECONDS)] = 0.0
    """Time until that change [s]."""
    then: Steady | None = None
    """Velocity from then on; None if it does not change within `MAX_MOTION_SECONDS`."""

    def after(self, time: float) -> complex:
        """Velocity [m/s; world frame] `time` [s] after the step."""
        if self.then is not None and time >= self.until:
            return self.then.after(time - self.until)
        return super().after(time)

    def moved(self, time: float) -> complex:
        """How far the leader has moved `time` [s] after the step [m; world frame]."""
        if self.then is None or time <= self.until:
            return _moved(self, time)
        return _moved(self, self.until) + _moved(self.then, time - self.until)


def _moved(steady: Steady, time: float) -> complex:
    displacement, _ = along(0j, complex(steady.x, steady.y), time, steady.turn_rate * time)
    return displacement


class Tuned(JsonMessage):
    """Gains of the law that replace the mission's."""

    k_p: Proportional
    """[1/s]"""
    k_i: Integral
    """[1/s²]"""

    @property
    def words(self) -> str:
        """``k_p = 2, k_i = 1``."""
        return f"k_p = {self.k_p:g}, k_i = {self.k_i:g}"


class Order(JsonMessage):
    """The leader's order to the fleet, with all that a successor needs to continue."""

    term: Count
    """Term of its leader: a later term replaces an earlier one. [ns] of its system clock or a little more,
    see `formation.protocol.election`."""
    beat: Count
    """Counts the leader's periods within its term."""
    mode: Mode
    shape: Name
    """Name of the mission's shape to hold."""
    rotation: Number = 0.0
    """Rotation of the shape, from its drawing or from the leader's heading [rad]."""
    scale: Scale = 1.0
    """Scale of the shape."""
    slots: Slots | None = None
    """Present slots; None: those of `shape`, `rotation` and `scale`."""
    base_mode: Literal["hold", "run"] = "run"
    """Mode that is in force once nothing is left to release."""
    holding: bool = False
    """Whether a hold is to be released before that."""
    route: Id = ""
    """Id of the leader's route; empty for the mission's own."""
    time: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    """Time since it began that route; of a driven leader, on the route before and driven since [s]."""
    place: Place | None = None
    """Its position."""
    motion: Motion | None = None
    """Its velocity; None while it stands, and where robots do not use it."""
    tuned: Tuned | None = None
    """Gains for all robots; None for the mission's."""
    driven: bool = False
    """Whether the leader is driven by hand: its beat then counts for `DRIVE_TIMEOUT_SECONDS` only."""

    @property
    def timeout(self) -> float:
        """Silence of its beat after which robots hold [s]."""
        return DRIVE_TIMEOUT_SECONDS if self.driven and self.mode == "run" else LEADER_TIMEOUT_SECONDS


def statement(fingerprint: str, text: str) -> bytes:
    """The bytes that a candidate signs for an order with this text, in the mission with this fingerprint."""
    return f"formation order\n{fingerprint}\n{text}".encode()


def newer(a: Order, b: Order | None) -> bool:
    """Whether `a` supersedes `b`: a later term, or a later beat of the same term. Any supersedes None."""
    return b is None or (a.term, a.beat) > (b.term, b.beat)
