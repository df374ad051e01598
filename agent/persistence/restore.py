"""What an agent restores after a restart, to continue smoothly, and stopped if it was stopped.

    stops   an operator's stop or hold, and the requests that were answered. It lasts until it is released,
            also across restarts. A file that cannot be read may have been a stop: the robot stands.
    state   the robot's pose, its odometry's frame, its integral and gains, and the voted term; and what is
            known of sensors that may be frozen, else each restart would drive blindly anew. Restored if it
            is of this robot, mission, law and boot, and a minute old at most; the pose also only if the
            first message of the new process follows from it. Otherwise the agent starts fresh. It then takes
            odometry that counts from the start as counted from the start pose. Where the saved state leaves
            a doubt of that, the robot is held until an operator orders ``run``.

An agent that begins again and again is held as well: what takes longer to notice than it runs would never be
noticed. Nothing of neighbours' messages is saved: they arrive within a period.
`formation.agent.persistence.persistence` connects this with the files.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, ValidationError

from formation.agent.core import Agent
from formation.agent.following.gains import TuningState
from formation.agent.following.relative_check import RelativeMemory
from formation.agent.persistence.state import (
    RESTORED,
    BadStateError,
    Codec,
    Json,
    Restored,
    dump,
    explained,
    overwrite,
    restore,
)
from formation.agent.pose.estimator import Localisation, LocalisationState
from formation.agent.pose.motion_check import MotionMemory
from formation.agent.pose.sources import ExternalPoseState, OdometryState, counts_from_start_pose
from formation.agent.safety.latch import HALTED, LatchState, is_own
from formation.agent.safety.scanner import ScanMemory
from formation.protocol.election import check_term
from formation.protocol.json_message import Id, Name
from formation.protocol.order import MAX_GAIN, MIN_GAIN, Mode
from formation.protocol.reasons import Code, Reason
from formation.protocol.stops import Once, Rest
from formation.ros2.messages import Odometry, Pose, decode
from formation.topics import ODOM, POSE
from formation.wire import BadMessage, Now, Sample

MAX_STATE_AGE = 60.0
"""Greatest age of a saved state [s]."""
MAX_INTEGRAL_AGE = 5.0
"""Greatest age of its integral: later the leader may move in another direction [s]."""
RESTARTS_TIME = 60.0
"""Time over which the starts of a robot's agents are counted [s]."""
MAX_STARTS = 6
"""Greatest number of starts within `RESTARTS_TIME`; with more the robot is held."""


class Stops(BaseModel):
    """An operator's requests to a robot."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)

    robot: Name
    mode: Mode | None
    """What is to be released first; None for nothing."""
    holding: bool = False
    """Whether there is a hold below a stop."""
    stop: Id = ""
    """Id of the stop in force."""
    hold: Id = ""
    """Id of the hold in force, below a stop too."""
    boot: str
    """Boot id of the machine: times are of its monotonic clock."""
    rested: float | Literal["never"]
    """When a stop or a hold was last received [s, monotonic]."""
    answers: dict[str, str]
    """Answers to requests, by kind and id."""
    why: Any = None
    """Code and values of the agent's own reasons to stop or hold the robot, by ``stop`` and ``hold``."""


@dataclass(slots=True, kw_only=True)
class Saved:
    """The saved state with which an agent continues smoothly."""

    robot: str
    mission: str
    """Fingerprint."""
    law: str
    boot: str
    mono: float
    """When it was saved [s, monotonic]."""
    voted_term: int
    """Voted term."""
    here: LocalisationState
    integral: complex
    tuning: TuningState
    """The integral's unit depends on the gains."""
    motion: MotionMemory
    """How the robot's motion differs from its commands."""
    tries: int
    """Number of probes since it was last seen to move."""
    scans: ScanMemory | None
    """None without a scanner."""
    relative: dict[str, RelativeMemory]
    """By neighbour that a sensor measures."""
    lost_locks: list[float]
    """Path since scans contradicted where the robot took itself to be [m], of the last times."""
    starts: list[float]
    """When the last agents of the robot began, this one among them [s, monotonic]."""


SAVED = Codec(Saved)


class Taken(NamedTuple):
    """What an agent has restored of the one before it, or why it has not."""

    restored: Restored | None
    """None for nothing."""
    news: str
    """A message for the operator; empty if there is none."""


class Restorer:
    """What one agent restores of the one before it, and saves for the next."""

    def __init__(self, agent: Agent, boot: str) -> None:
        """`boot` is the id of the time since this machine was switched on or woke; empty if unknown."""
        self._agent, self._boot = agent, boot
        self._mission = agent.mission
        self._external = self._mission.robots[agent.robot].localisation == "external"
        self._counts_from_start = (
            not self._external and self._mission.robots[agent.robot].odometry_frame == "start"
        )
        self._saved: Saved | None = None
        self._refused: tuple[Saved, str] | None = None  # a state that is not restored, and why
        self._starts: list[float] = []  # of the last agents and of this one [s, monotonic]

    def take_stops(self, data: bytes, now: Now, where: str) -> Taken:
        """Restore a stop or a hold; `where` is the name of the file.

        A file that cannot be read counts as a stop, and the reason says so.
        """
        try:
            stops = Stops.model_validate_json(data)
            if stops.robot != self._agent.robot:
                raise BadStateError(f"it is of {stops.robot}")
            rested = self._rested(stops, now)
            drawn = f"saved-{now.mono:.6f}"  # for a file of a version without ids
            known = "" if stops.stop == HALTED else stops.stop
            stop = (known or drawn) if stops.mode == "stop" else ""
            hold = (stops.hold or drawn) if stops.holding or stops.mode == "hold" else ""
            stopped = _reason(stops.why, "stop") or Reason(Code.STOPPED_BEFORE_START)
            held = _reason(stops.why, "hold")
            if held is None and not stop:
                held = Reason(Code.HELD_BEFORE_START)
            return self._latch(LatchState(
                rest=Rest(stop, hold), stop_reason=stopped if stop else None,
                hold_reason=held if hold else None,
                once=Once(rested, stops.answers),
            ))  # fmt: skip
        except Exception as bad:  # noqa: BLE001 - whatever stands in the file, the robot is stopped
            return self.doubt(f"{where} cannot be read: {_described(bad)}", now)

    def doubt(self, what: str, now: Now) -> Taken:
        """Stop the robot, because `what` may have been a stop."""
        why = Reason.of(Code.STOP_UNKNOWN, detail=what)
        return self._latch(LatchState(rest=Rest(f"doubt-{now.mono:.6f}"), stop_reason=why))

    @property
    def stops(self) -> dict[str, Json]:
        """An operator's requests, to be saved with `json`."""
        return self._stops(self._agent.state.latch)

    def failed(self, what: str, now: Now) -> dict[str, Json]:
        """Return the stops of an agent that has failed: its robot is held too, because of `what`."""
        latch = self._agent.state.latch
        rest = Rest("" if latch.rest.stop == HALTED else latch.rest.stop, latch.rest.hold)
        return self._stops(_held(replace(latch, rest=rest), Reason.of(Code.AGENT_FAILS, detail=what), now))

    def _stops(self, latch: LatchState) -> dict[str, Json]:
        rest, rested = latch.rest, latch.once.rested
        reasons = {"stop": latch.stop_reason, "hold": latch.hold_reason}
        why = {name: (one.code, dict(one.values)) for name, one in reasons.items() if one and is_own(one)}
        stops = Stops.model_construct(
            robot=self._agent.robot,
            mode=rest.mode,
            holding=bool(rest.stop and rest.hold),
            stop=rest.stop,
            hold=rest.hold,
            boot=self._boot,
            rested="never" if rested == float("-inf") else rested,
            answers=latch.once.answers,
            why=why or None,
        )
        # a version without ids would read a file that has them for nothing as no stop
        return stops.model_dump(exclude_defaults=True)

    def take_saved(self, data: bytes, now: Now) -> Taken:
        """Keep a saved state for the robot's first message; its voted term counts at once."""
        try:
            saved = SAVED.read(data)
            unfit = self._unfit(saved, now)
        except Exception as bad:  # noqa: BLE001 - whatever stands in the file, the agent starts fresh
            return self.unreadable(f"cannot be read: {_described(bad)}", now)
        if unfit:
            if self._counts_from_start and saved.robot == self._agent.robot:
                self._refused = saved, unfit
            return _anew(unfit)
        self._saved = saved
        recent = [one for one in saved.starts if now.mono - one < RESTARTS_TIME]
        self._starts = [*recent[-MAX_STARTS:], now.mono]
        restored = Restored(
            voted_term=saved.voted_term,
            scans=saved.scans,
            relative=saved.relative,
            lost_locks=saved.lost_locks,
        )
        if len(self._starts) <= MAX_STARTS:
            return self._taken(restored, "")
        what = f"its agent began more than {MAX_STARTS} times within {RESTARTS_TIME:g} s"
        return self._hold(Reason.of(Code.AGENT_FAILS, detail=what), now, restored)

    def unreadable(self, why: str, now: Now) -> Taken:
        """Start without a saved state that cannot be read."""
        return self._unplaced(why, now) if self._counts_from_start else _anew(why)

    @property
    def waits(self) -> bool:
        """Whether a saved state waits for the robot's first message."""
        return self._saved is not None or self._refused is not None

    def meet(self, inbox: Sequence[Sample], now: Now) -> Taken | None:
        """Restore the saved state, if the robot's first message follows from it."""
        key = (POSE if self._external else ODOM).key(self._agent.robot)
        sample = next((sample for sample in inbox if sample.key == key), None)
        if sample is None:
            return None
        try:
            message = decode(Pose, sample.payload) if self._external else decode(Odometry, sample.payload)
        except BadMessage:
            return None  # the agent will report it
        saved, self._saved = self._saved, None
        refused, self._refused = self._refused, None
        if refused is not None:
            return self._started_anew(*refused, message, now)
        return None if saved is None else self._restored(saved, message, sample.arrived, inbox, now)

    def _restored(
        self, saved: Saved, message: Odometry | Pose, arrived: float, inbox: Sequence[Sample], now: Now
    ) -> Taken:
        """Restore a saved state, if the robot's first `message` follows from it."""
        if unfit := self._unfit(saved, now):
            return self._started_anew(saved, unfit, message, now) or _anew(unfit)
        here = Localisation(self._mission, self._agent.robot, self._agent.controller)
        try:
            overwrite(here.state, saved.here)
            if strange := here.goes_on(message, arrived, saved.mono):
                return self._started_anew(saved, strange, message, now) or _anew(strange)
            age = arrived - saved.mono
            integral = saved.integral if age <= MAX_INTEGRAL_AGE else None
            restored = Restored(here=here.state, integral=integral, tuning=saved.tuning)
            if not self._agent.readonly:
                restored = replace(restored, motion=saved.motion, tries=saved.tries)
            self._rehearse(restored, inbox, now)
            return self._taken(restored, f"goes on from where it was {age:.1f} s ago")
        except Exception as bad:  # noqa: BLE001 - whatever stands in the file, the agent starts fresh
            return self.unreadable(f"cannot be read: {_described(bad)}", now)

    def _started_anew(self, saved: Saved, why: str, message: Odometry | Pose, now: Now) -> Taken | None:
        """Hold the robot unless `message` counts on from the saved state, and that from the start pose."""
        source = saved.here.source
        if not self._counts_from_start or not isinstance(message, Odometry):
            return None
        counts_on = isinstance(source, OdometryState) and counts_from_start_pose(
            source, message, self._mission.robots[self._agent.robot].start
        )
        return None if counts_on else self._unplaced(why, now)

    def _unplaced(self, why: str, now: Now) -> Taken:
        """Hold the robot until an operator orders run, below a stop that is in force."""
        return self._hold(Reason.of(Code.UNPLACED, detail=why), now, Restored())

    def _hold(self, why: Reason, now: Now, restored: Restored) -> Taken:
        return self._taken(replace(restored, latch=_held(self._agent.state.latch, why, now)), str(why))

    def saved(self, now: Now) -> Json | None:
        """The state to be saved with `json`; None before the robot's first message."""
        state = self._agent.state
        here = state.here
        if here.stream.arrived is None:
            return None
        self._starts = self._starts or [now.mono]
        if isinstance(here.source, ExternalPoseState):  # the commands do not tell how it has turned since
            here = replace(here, source=replace(here.source, sent=deque()))
        return SAVED.write(
            Saved(
                robot=self._agent.robot,
                mission=self._mission.fingerprint,
                law=self._agent.controller.name,
                boot=self._boot,
                mono=now.mono,
                voted_term=state.orders.voter.voted_term,
                here=here,
                integral=state.integral,
                tuning=state.tuning,
                motion=self._agent.motion.memory,
                tries=state.probe.tries,
                scans=None if self._agent.avoiding.scanner is None else self._agent.avoiding.scanner.memory,
                relative=self._agent.neighbours.memory,
                lost_locks=[] if self._agent.perception is None else self._agent.perception.lost_locks,
                starts=self._starts,
            )
        )

    def _latch(self, latch: LatchState) -> Taken:
        return self._taken(Restored(latch=latch), "" if latch.why is None else str(latch.why))

    def _rehearse(self, restored: Restored, inbox: Sequence[Sample], now: Now) -> None:
        """Restore it in another agent and step that: raises what this agent would have failed with."""
        agent = self._agent
        other = Agent(self._mission, agent.robot, agent.controller.name, readonly=True)
        restore(other, dump(agent))
        RESTORED.read(RESTORED.write(restored)).into(other)
        other.act(now, inbox)
        other.tell(now)

    def _taken(self, restored: Restored, news: str) -> Taken:
        restored.into(self._agent)
        return Taken(restored, news)

    def _rested(self, stops: Stops, now: Now) -> float:
        """When a stop or a hold was last received [s, monotonic]; now if unknown."""
        if stops.rested == "never":
            return float("-inf")
        known = stops.boot == self._boot and self._boot
        return min(stops.rested, now.mono) if known else now.mono

    def _unfit(self, saved: Saved, now: Now) -> str:
        """Why this agent cannot use it, in words."""
        agent = self._agent
        for name, theirs, ours in (
            ("robot", saved.robot, agent.robot),
            ("mission", saved.mission, self._mission.fingerprint),
            ("law", saved.law, agent.controller.name),
        ):
            if theirs != ours:
                return f"it is of {name} {theirs}, this one of {ours}"
        if odd := _odd(saved):
            return odd
        try:
            check_term(saved.voted_term, now)
        except BadMessage as bad:
            return f"it has voted for an {bad}"
        age = now.mono - saved.mono
        if saved.boot != self._boot or not self._boot or age < 0.0:
            return "the machine has been switched off or suspended meanwhile"
        return (
            f"it was saved {age:.0f} s ago, which is more than {MAX_STATE_AGE:.0f} s"
            if age > MAX_STATE_AGE
            else ""
        )


def _held(latch: LatchState, why: Reason, now: Now) -> LatchState:
    """The same with a new hold, below a stop that is in force; no request of before it ends it."""
    once = replace(latch.once, rested=max(latch.once.rested, now.mono))
    rest = Rest(latch.rest.stop, f"{why.code}-{now.mono:.6f}")
    return replace(latch, rest=rest, hold_reason=why, once=once)


def _reason(why: Any, name: str) -> Reason | None:
    """The reason of that name in a file; None if there is none, and for one of another version."""
    try:
        code, values = why[name]
        return Reason.read(code, values)
    except (TypeError, ValueError, AttributeError, KeyError):
        return None


def _described(error: Exception) -> str:
    if isinstance(error, ValidationError):
        return explained(error)[:200]
    kind = "" if isinstance(error, BadStateError) else f"{type(error).__name__}: "
    return f"{kind}{' '.join(str(error).split())[:200]}"


def _odd(saved: Saved) -> str:
    """Which of its numbers is impossible; empty if there is none."""
    written = SAVED.write(saved)
    if '"NaN"' in json.dumps(written):
        return "a number in it is not finite"
    if 'Infinity"' in json.dumps(written["here"]["source"]):
        return "its newest position or motion is infinite"
    gains = saved.tuning
    if not (MIN_GAIN <= gains.k_p <= MAX_GAIN and 0.0 <= gains.k_i <= MAX_GAIN):
        return f"its gains must be k_p {MIN_GAIN:g} to {MAX_GAIN:g}, k_i 0 to {MAX_GAIN:g}"
    return ""


def _anew(why: str) -> Taken:
    return Taken(None, f"starts without the saved state: {why}")
