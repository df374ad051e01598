"""What of an agent outlives its process, so that it comes back without a lurch, and stopped if it was.

    stops   what an operator asked of the robot, and which requests were answered. It holds until it is
            released, whatever happens in between. What cannot be read may have been a stop: the robot stands.
    way     where the robot was and how it faced, by which odometry, its integral and gains, the promised
            term. Taken over if it is of this robot, mission, law and boot, a minute old at most, and if the
            first message of the new process follows from it; else the agent begins as one that knows nothing.

Of neighbours nothing is kept: they are heard again within a period. `agent.keeping` has the files.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from agent.core import Agent
from agent.localisation import Localisation
from agent.memory import BadMemoryError, Json, recall, remember
from agent.values import real
from formation.election import check_term
from formation.order import LEAST_GAIN, MOST_GAIN, Count, Mode, Name, Voice
from formation.ros2.messages import Odometry, Pose, decode
from formation.topics import ODOM, POSE
from formation.wire import BadMessage, Now, Sample

PERIOD = 0.25
"""So often a way is kept [s]."""
OLDEST = 60.0
"""A way that was kept longer ago is of no use [s]."""
OLDEST_INTEGRAL = 5.0
"""… and its integral after so long: the leader may by then go another way [s]."""
_DONE = {"stop": "stopped", "hold": "held", "run": "released"}


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Stops(_Table):
    """What an operator asked of a robot."""

    robot: Name
    mode: Mode | None
    """What is to be released first; None for nothing."""
    holding: bool = False
    """Whether there is a hold below a stop."""
    stop: Voice = ""
    """Id of the stop in force."""
    hold: Voice = ""
    """Id of the hold in force, below a stop too."""
    boot: str
    """Of the machine: times are of its monotonic clock."""
    rested: float | Literal["never"]
    """When a stop or a hold was heard last [s, monotonic]."""
    answers: dict[str, str]
    """To requests, each by what it was and its id."""


class Way(_Table):
    """What lets an agent go on smoothly."""

    robot: Name
    mission: str
    """Fingerprint."""
    law: str
    boot: str
    mono: float
    """When it was kept [s, monotonic]."""
    promise: Count
    """Term that the agent has promised itself to."""
    here: dict[str, Any]
    """The memory of its `agent.localisation`."""
    integral: Any
    tuning: Any
    """The memory of its `agent.tuning`: what the integral stands for depends on the gains."""


class Taken(NamedTuple):
    """What an agent has taken over from the one before it, or why it has not."""

    memory: dict[str, Json]
    """For its trace; empty for nothing."""
    news: str
    """In a sentence; empty for nothing worth one."""


class Survival:
    """What one agent takes over from the one before it, and leaves to the next."""

    def __init__(self, agent: Agent, boot: str) -> None:
        """`boot` names the time since this machine was switched on; empty where nobody knows."""
        self._agent, self._boot = agent, boot
        self._mission = agent._mission  # noqa: SLF001 - as in a trace, this is the agent's other half
        self._external = self._mission.robots[agent.robot].localisation == "external"
        self._way: Way | None = None

    def take_stops(self, data: bytes, now: Now, where: str) -> Taken:
        """Be stopped, or held, if that was kept; `where` is what the file is called.

        A file that cannot be read is a stop, which says so.
        """
        try:
            stops = _read(Stops, data)
            if stops.robot != self._agent.robot:
                raise BadMemoryError(f"it is of {stops.robot}")
            why = f"{_DONE[stops.mode]} by the operator, before this agent began" if stops.mode else ""
            rested = self._rested(stops, now)
            drawn = f"kept-{now.mono:.6f}"  # for a file of a version without ids
            stop = (stops.stop or drawn) if stops.mode == "stop" else ""
            hold = (stops.hold or drawn) if stops.holding or stops.mode == "hold" else ""
            return self._latch(why, rested, stops.answers, stop=stop, hold=hold)
        except Exception as bad:  # noqa: BLE001 - whatever stands in the file, the robot is stopped
            return self.doubt(f"{where} cannot be read: {_told(bad)}", now)

    def doubt(self, what: str, now: Now) -> Taken:
        """Be stopped, for `what` may have been a stop."""
        why = f"{what}; it may have kept a stop, so release it if it may drive"
        return self._latch(why, float("-inf"), {}, stop=f"doubt-{now.mono:.6f}")

    @property
    def stops(self) -> dict[str, Json]:
        """What is to be kept of an operator's requests, for `json`."""
        latch = self._agent._latch  # noqa: SLF001
        rested = latch.once.rested
        return {
            "robot": self._agent.robot,
            "mode": latch.mode,
            # written only where there is one: a version without ids reads a file that stops nobody
            **({"holding": True} if latch.rest.stop and latch.rest.hold else {}),
            **({"stop": latch.rest.stop} if latch.rest.stop else {}),
            **({"hold": latch.rest.hold} if latch.rest.hold else {}),
            "boot": self._boot,
            "rested": "never" if rested == float("-inf") else rested,
            "answers": latch.once.answers,
        }

    def take_way(self, data: bytes, now: Now) -> Taken:
        """Wait, with the way that was kept, for the robot's first message; its promise counts at once."""
        try:
            way = _read(Way, data)
            unfit = self._unfit(way, now)
        except Exception as bad:  # noqa: BLE001 - whatever stands in the file, the agent starts fresh
            return _anew(f"cannot be read: {_told(bad)}")
        if unfit:
            return _anew(unfit)
        self._way = way
        orders = remember(self._agent, "orders")["orders"]
        orders["voter"]["promise"] = way.promise
        return self._taken({"orders": orders}, "")

    @property
    def waits(self) -> bool:
        """Whether a way waits for the robot's first message."""
        return self._way is not None

    def meet(self, inbox: Sequence[Sample], now: Now) -> Taken | None:
        """Go on from the way that was kept, if the robot's first message, once it comes, follows from it."""
        way, key = self._way, (POSE if self._external else ODOM).key(self._agent.robot)
        sample = next((sample for sample in inbox if sample.key == key), None)
        if sample is None or way is None:
            return None
        try:
            message = decode(Pose, sample.payload) if self._external else decode(Odometry, sample.payload)
        except BadMessage:
            return None  # the agent will say so
        self._way = None
        if unfit := self._unfit(way, now):
            return _anew(unfit)
        here = Localisation(self._mission, self._agent.robot, self._agent.law_name)
        try:
            recall(here, way.here)
            if strange := here.goes_on(message, sample.arrived, way.mono):
                return _anew(strange)
            age = sample.arrived - way.mono
            memory = {"here": remember(here), "integral": way.integral, "tuning": way.tuning}
            if age > OLDEST_INTEGRAL:
                del memory["integral"]
            self._rehearse(memory, inbox, now)
            return self._taken(memory, f"goes on from where it was {age:.1f} s ago")
        except Exception as bad:  # noqa: BLE001 - whatever stands in the file, the agent starts fresh
            return _anew(f"cannot be read: {_told(bad)}")

    def way(self, now: Now) -> dict[str, Json] | None:
        """What is to be kept now and then, for `json`; None before the robot has been heard."""
        known = remember(self._agent, "here", "integral", "tuning")
        if known["here"]["stream"]["arrived"] is None:
            return None
        if self._external:  # what it was told until then does not say how it has turned since
            known["here"]["source"]["sent"] = []
        return {
            "robot": self._agent.robot,
            "mission": self._mission.fingerprint,
            "law": self._agent.law_name,
            "boot": self._boot,
            "mono": now.mono,
            "promise": self._agent._orders.voter.promise,  # noqa: SLF001
            "here": known["here"],
            "integral": known["integral"],
            "tuning": known["tuning"],
        }

    def _latch(
        self, why: str, rested: float, answers: dict[str, str], *, stop: str = "", hold: str = ""
    ) -> Taken:
        once = {"rested": real.said(rested), "answers": answers}
        latch = {"rest": {"stop": stop, "hold": hold}, "why": why, "once": once}
        return self._taken({"latch": latch}, why)

    def _rehearse(self, memory: dict[str, Json], inbox: Sequence[Sample], now: Now) -> None:
        """Have another agent take over `memory` and step: raises what this agent would have failed with."""
        agent = self._agent
        other = Agent(self._mission, agent.robot, agent.law_name, readonly=True)
        recall(other, {**remember(agent), **memory})
        other.act(now, inbox)
        other.tell(now)

    def _taken(self, memory: dict[str, Json], news: str) -> Taken:
        recall(self._agent, memory, partly=True)
        return Taken(memory, news)

    def _rested(self, stops: Stops, now: Now) -> float:
        """When a stop or a hold was heard last [s, monotonic]; where nobody knows, just now."""
        if stops.rested == "never":
            return float("-inf")
        known = stops.boot == self._boot and self._boot
        return min(stops.rested, now.mono) if known else now.mono

    def _unfit(self, way: Way, now: Now) -> str:
        """Why it is of no use to this agent, in words."""
        agent = self._agent
        ours = {"robot": agent.robot, "mission": self._mission.fingerprint, "law": agent.law_name}
        for name, mine in ours.items():
            if (theirs := getattr(way, name)) != mine:
                return f"it is of {name} {theirs}, this one of {mine}"
        if odd := _odd(way):
            return odd
        try:
            check_term(way.promise, now)
        except BadMessage as bad:
            return f"it has promised itself to an {bad}"
        age = now.mono - way.mono
        if way.boot != self._boot or not self._boot or age < 0.0:
            return "the machine has been switched off meanwhile"
        return f"it was kept {age:.0f} s ago, which is more than {OLDEST:.0f} s" if age > OLDEST else ""


T = TypeVar("T", Stops, Way)


def _read(table: type[T], data: bytes) -> T:
    """Raises BadMemoryError."""
    try:
        return table.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
    where = ".".join(map(str, first["loc"]))
    raise BadMemoryError(f"{where + ': ' if where else ''}{first['msg']}")


def _told(error: Exception) -> str:
    """Why something cannot be taken over, in one line."""
    kind = "" if isinstance(error, BadMemoryError) else f"{type(error).__name__}: "
    return f"{kind}{' '.join(str(error).split())[:200]}"


def _odd(way: Way) -> str:
    """Which of its numbers no agent can have known; empty if there is none."""
    if _holds([way.here, way.integral, way.tuning], {"nan"}):
        return "a number in it is none"
    if _holds(way.here.get("source"), {"inf", "-inf"}):
        return "its newest position or motion is infinite"
    if isinstance(way.tuning, dict) and not _bearable(way.tuning):
        return f"its gains must be k_p {LEAST_GAIN:g} to {MOST_GAIN:g}, k_i 0 to {MOST_GAIN:g}"
    return ""


def _holds(said: Json, numbers: Collection[str]) -> bool:
    """Whether one of these `numbers`, as they are kept, stands anywhere in what was `said`."""
    if isinstance(said, (dict, list)):
        return any(_holds(one, numbers) for one in (said.values() if isinstance(said, dict) else said))
    return isinstance(said, str) and said in numbers


def _bearable(tuning: Mapping[str, Json]) -> bool:
    """Whether these are gains that an order can have given."""
    gains = tuning.get("k_p"), tuning.get("k_i")
    return all(
        isinstance(gain, (int, float)) and least <= gain <= MOST_GAIN
        for gain, least in zip(gains, (LEAST_GAIN, 0.0), strict=True)
    )


def _anew(why: str) -> Taken:
    return Taken({}, f"begins as one that knows nothing of the agent before it: {why}")
