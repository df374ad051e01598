r"""What makes a run repeatable: beside each command, all that the agent went by since the one before.

The trace rides as an attachment on what the fleet hears of `CMD_VEL`. It names each message by key and
checksum, since the messages themselves are in the recording, and says when it arrived and by which clocks the
agent took the step; now and then it carries the agent's memory, from which a recording that began later, or
has lost something, is followed again. `agent.verify` reads it.

    {"n": 17, "voice": "…",                          the 17th command of this voice
     "steps": [[mono, wall, [[key, crc, arrived], …]],          key: which of the agent's subscriptions
               (for an order that did not count besides: why, and whether it was forged)
               [mono, wall, […], [connected, routed, rival]],   the robot's side, where that has changed
               [heard, "{\"do\": …}"],                          an operator's request, between two steps
               {"recalled": {…}}],                              what it took over from the process before it
     "halt": [mono, wall],                           after these steps the agent said its last words
     "gap": "…",                                     instead of steps: why they are not told
     "agent": {"law": …, "readonly": …, "mission": …, "keys": […]}, "memory": {…}}      after the command

It is made when the command has long gone to the robot, and whatever happens in here reaches nobody else: a
trace that cannot be made is left out, counted, and begun anew with a memory.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from zlib import crc32

from agent.core import Agent
from agent.memory import Json, remember
from formation.order import MAX_REQUEST
from formation.ros2.messages import MAX_BYTES
from formation.ros2.ros_names import address
from formation.wire import Now, Sample

MEMORY_PERIOD = 5.0
"""[s]"""
AGAIN = 1.0
"""After what could not be told a memory comes sooner, but not sooner than so [s]."""
MOST = 400
"""So many messages, steps and requests between two commands are told; at 200 Hz there are a few."""
LONGEST = MAX_BYTES - 1024
"""[bytes], so that a recording can keep it."""
Link = tuple[bool | None, bool | None, bool]
"""Of `agent.status.Surroundings`: connected, routed, rival."""
_encode = json.JSONEncoder(separators=(",", ":"), allow_nan=False).encode


class Trace:
    """What one agent has gone by since its newest command."""

    def __init__(self, agent: Agent) -> None:
        self.failures = 0
        """How many traces could not be made."""
        self.failure = ""
        """Why not, the last time."""
        self._agent = agent
        self._about = {
            "law": agent.law_name,
            "readonly": agent._readonly,  # noqa: SLF001 - as with memory, this is the agent's other half
            "mission": agent._mission.fingerprint,  # noqa: SLF001
            "keys": agent.subscriptions,
        }
        self._voice = agent._voice  # noqa: SLF001
        self._numbers = {key: number for number, key in enumerate(agent.subscriptions)}
        self._count = 0
        self._link: Link | None = (None, None, False)  # as last told
        self._steps: list[Json] = []
        self._room = MOST
        self._halt: Now | None = None
        self._gap = ""
        self._mono = 0.0  # of the newest step
        self._remembered = float("-inf")  # [s, monotonic]

    def stepped(self, now: Now, link: Link, heard: Sequence[Sample]) -> None:
        """The agent took a step. Never raises."""
        try:
            self._mono = now.mono
            if not self._makes_room(1 + len(heard)):
                return
            step: list[Json] = [now.mono, now.wall, [self._named(sample) for sample in heard]]
            if link != self._link:
                self._link = link
                step.append(link)
            self._steps.append(step)
        except Exception as error:  # noqa: BLE001 - whatever it is, the agent drives on
            self._fail(error)

    def asked(self, request: bytes, heard: float) -> None:
        """An operator asked something of the agent, at `heard` [s, monotonic]. Never raises."""
        try:  # what is too long or no text is refused, and changes nothing that a command follows from
            if len(request) <= MAX_REQUEST and self._makes_room(1):
                self._steps.append([heard, request.decode()])
        except UnicodeDecodeError:
            return
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)

    def recalled(self, memory: Json) -> None:
        """The agent took this over from another that ran before it. Never raises."""
        try:
            if self._makes_room(1):
                self._steps.append({"recalled": memory})
        except Exception as error:  # noqa: BLE001 - as above
            self._fail(error)

    def halted(self, now: Now) -> None:
        """The agent says its last words."""
        self._mono, self._halt = now.mono, now

    def attachment(self) -> bytes | None:
        """The trace of the command that was just said; None where there can be none. Never raises."""
        self._count += 1
        for _ in range(2):  # if not the steps, then that they cannot be told
            try:
                trace = self._told().encode()
            except Exception as error:  # noqa: BLE001 - as above
                self._fail(error)
            else:
                self._steps, self._room, self._halt, self._gap = [], MOST, None, ""
                return trace
        return None

    def _told(self) -> str:
        told: dict[str, Json] = {"n": self._count, "voice": self._voice}
        told |= {"gap": self._gap} if self._gap else {"steps": self._steps}
        if self._halt is not None:
            told["halt"] = self._halt
        if self._mono - self._remembered < (AGAIN if self._gap else MEMORY_PERIOD):
            return _within(LONGEST, _encode(told))
        self._remembered = self._mono
        text = _within(LONGEST, _encode({**told, "agent": self._about}))
        try:
            return _within(LONGEST, f'{text[:-1]},"memory":{_encode(remember(self._agent))}}}')
        except Exception as error:  # noqa: BLE001 - the steps may still be told
            self._count_failure(error)
            return text

    def _named(self, sample: Sample) -> list[Json]:
        if len(sample.payload) + len(sample.attachment or b"") > MAX_BYTES:
            raise ValueError(f"a message on {sample.key} is longer than any that is read")
        named: list[Json] = [self._numbers[sample.key], checksum(sample), sample.arrived]
        return [*named, sample.unverified, sample.forged] if sample.unverified else named

    def _makes_room(self, entries: int) -> bool:
        self._room -= entries
        if self._room < 0 and not self._gap:
            self._begin_anew(f"more than {MOST} messages between two commands")
        return not self._gap

    def _fail(self, error: Exception) -> None:
        self._count_failure(error)
        self._begin_anew(f"could not be told: {self.failure}")

    def _begin_anew(self, gap: str) -> None:
        """Tell none of the steps so far, but why not; the link is then told whether it has changed or not."""
        self._steps, self._link, self._gap = [], None, gap

    def _count_failure(self, error: Exception) -> None:
        self.failures += 1
        self.failure = str(error)[:200] or type(error).__name__


def checksum(sample: Sample) -> int:
    """By which a message is found again among those on its key.

    What rode on it counts only between robots: on a robot ROS decides what rides, and nobody repeats that.
    """
    found = crc32(sample.payload)
    if sample.attachment is None or not _between_robots(sample.key):
        return found
    return crc32(sample.attachment, found)


@cache
def _between_robots(key: str) -> bool:
    return address(key).topic.side == "fleet"


def _within(longest: int, text: str) -> str:
    if len(text) > longest:
        raise ValueError(f"{len(text)} bytes, at most {longest} are told")
    return text
