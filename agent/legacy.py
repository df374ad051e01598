"""What an agent finds of the one before it, and leaves to the next: `agent.survival` and its files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from agent.core import Agent
from agent.keeping import Keeping
from agent.survival import PERIOD, Survival, Taken
from formation.wire import Now, Sample

TRUSTED = 10.0
"""Saved state is to blame if its agent fails within so long of taking it over [s]."""
PATIENCE = 0.05
"""An acknowledgement waits at most so long for the file that it promises [s]."""


class Legacy:
    """Between one agent and the folder that it keeps things in."""

    def __init__(self, agent: Agent, keeping: Keeping, boot: str) -> None:
        """`boot` names the time since this machine was switched on; empty where nobody knows."""
        self._survival, self._keeping = Survival(agent, boot), keeping
        self._due = float("-inf")  # [s, monotonic]
        self._asked = False  # since the newest step
        self._error = ""  # why the newest way cannot be said
        self._met, self._failed = float("-inf"), False  # when the way was taken over [s, monotonic]

    @property
    def failure(self) -> str:
        """Why something cannot be kept just now; empty if all can."""
        return self._error or self._keeping.failure

    def found(self, now: Now) -> Iterator[Taken]:
        """Take over what was left; to be called before the agent is asked or steps."""
        where = str(self._keeping.stops)
        try:
            stops = self._keeping.read_stops()
        except OSError as error:
            yield self._survival.doubt(f"{where} cannot be read: {error.strerror or error}", now)
        else:
            if stops is not None:
                yield self._survival.take_stops(stops, now, where)
        try:
            way = self._keeping.read_way()
        except OSError as error:
            yield Taken({}, f"begins as one that knows nothing of the agent before it: {error}")
        else:
            if way is not None:
                yield self._survival.take_way(way, now)

    def met(self, now: Now, inbox: Sequence[Sample]) -> Taken | None:
        """Take over what waits for the robot's first message; to be called before a step."""
        taken = self._survival.meet(inbox, now) if self._survival.waits else None
        if taken is not None and taken.memory:
            self._met = now.mono
        return taken

    def asked(self) -> None:
        """An operator has asked something; it is kept with the next step, or when `kept` is called."""
        self._asked = True

    def kept(self) -> bool:
        """Wait until that is safe from a kill; whether it is. A disk that hangs is not waited for long."""
        if self._asked:
            self._keeping.keep_stops(self._survival.stops)
        return self._keeping.written(PATIENCE)

    def stepped(self, now: Now) -> None:
        """The agent has taken a step, and its robot knows by now what was asked."""
        if self._asked:
            self._asked = False
            self._keeping.keep_stops(self._survival.stops)
        if now.mono >= self._due:
            self.end(now)

    def failed(self, now: Now) -> str:
        """The agent has failed: where its saved state was set aside, in a sentence; empty if it was not.

        An agent that fails soon after taking it over would do so again at each start.
        """
        if now.mono - self._met > TRUSTED:
            return ""
        self._failed = True
        aside = self._keeping.set_aside_way()
        where = f"is now {aside}" if aside else "could not be set aside"
        return f"failed {now.mono - self._met:.1f} s after it took over saved state, which {where}"

    def end(self, now: Now) -> None:
        """The agent ends, or has gone on for a while. Never raises."""
        if self._failed:
            return
        self._due = now.mono + PERIOD
        try:
            way = self._survival.way(now)
        except Exception as error:  # noqa: BLE001 - whatever it is, the agent drives on
            self._error = str(error) or type(error).__name__
            return
        self._error = ""
        if way is not None and not self._survival.waits:
            self._keeping.keep_way(way)
