"""The saved files of one agent: what is read when it begins, and written while it runs and when it fails.

`formation.agent.persistence.restore` says what is in them, `formation.agent.persistence.store` writes them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from formation.agent.core import Agent
from formation.agent.persistence.restore import Restorer, Taken
from formation.agent.persistence.state import Json
from formation.wire import Now, Sample

SAVE_PERIOD = 0.25
"""Period of saving the state [s]; for so long after the first time every step saves it."""
RESTORE_TRIAL_TIME = 10.0
"""Time after restoring within which a failure of the agent is blamed on the saved state [s]."""
MAX_SAVE_WAIT = 0.05
"""Longest time that an acknowledgement waits for its file [s]."""
MAX_LAST_SAVE_WAIT = 1.0
"""Longest time that a failed agent waits for its file [s]."""


class _Files(Protocol):
    """What is used of a `Store`; a rehearsal has its own."""

    @property
    def stops(self) -> Path: ...
    @property
    def failure(self) -> str: ...
    @property
    def stops_failed(self) -> bool: ...
    def written(self, patience: float) -> bool: ...
    def write_stops(self, stops: Json) -> None: ...
    def write_state(self, state: Json) -> None: ...
    def read_stops(self) -> bytes | None: ...
    def read_state(self) -> bytes | None: ...
    def set_state_aside(self) -> Path | None: ...


class Persistence:
    """Connects one agent with the folder of its saved state."""

    def __init__(self, agent: Agent, store: _Files, boot: str) -> None:
        """`boot` is the id of the time since this machine was switched on or woke; empty if unknown."""
        self._restorer, self._store = Restorer(agent, boot), store
        self._due = float("-inf")  # [s, monotonic]
        self._since = float("inf")  # when the state was first saved [s, monotonic]
        self._requested = False  # since the newest step
        self._retry = float("-inf")  # when stops that could not be written are tried again [s, monotonic]
        self._unsaved = False  # whether a hold of its own may not be saved yet
        self._error = ""  # why the newest state cannot be saved
        self._met, self._failed = float("-inf"), False  # when the state was restored [s, monotonic]

    @property
    def failure(self) -> str:
        """Why something cannot be saved now; empty if all can."""
        return self._error or self._store.failure

    def found(self, now: Now) -> Iterator[Taken]:
        """Restore what was saved; call this before the agent's first request or step."""
        where = str(self._store.stops)
        try:
            stops = self._store.read_stops()
        except OSError as error:
            yield self._restorer.doubt(f"{where} cannot be read: {error.strerror or error}", now)
        else:
            if stops is not None:
                yield self._restorer.take_stops(stops, now, where)
        try:
            saved = self._store.read_state()
        except OSError as error:
            yield self._noted(self._restorer.unreadable(str(error), now), now)
        else:
            if saved is not None:
                yield self._noted(self._restorer.take_saved(saved, now), now)

    def met(self, now: Now, inbox: Sequence[Sample]) -> Taken | None:
        """Restore the state that waits for the robot's first message; call this before a step."""
        taken = self._restorer.meet(inbox, now) if self._restorer.waits else None
        return None if taken is None else self._noted(taken, now)

    def _noted(self, taken: Taken, now: Now) -> Taken:
        """Have a new hold saved with the next step: it must outlive the next restart too."""
        if taken.restored is not None:
            self._met = now.mono
            if taken.restored.latch is not None:
                self._requested = self._unsaved = True
        return taken

    def requested(self) -> None:
        """Note an operator's request; it is saved in the next step, or when `saved` is called."""
        self._requested = True

    def saved(self) -> bool:
        """Wait briefly until the request survives a kill; whether it does."""
        if self._requested and not self._failed:
            self._store.write_stops(self._restorer.stops)
        return self._store.written(MAX_SAVE_WAIT)

    def stepped(self, now: Now) -> None:
        """Save after a step, when the robot has already received its command.

        The first state that can be saved is, at once, and so are those of the next steps: an agent that is
        killed soon must count as well, and so must its motion.
        """
        if self._failed:
            return
        if self._requested or (self._store.stops_failed and now.mono >= self._retry):
            self._requested, self._retry = False, now.mono + SAVE_PERIOD
            self._store.write_stops(self._restorer.stops)
        if now.mono >= self._due:
            self.end(now)

    def failed(self, now: Now) -> str:
        """Hold the robot of an agent that fails soon after restoring the state; return a sentence, or "".

        It would fail again at each start, so its saved state is renamed. Without that state the next agent
        knows of no doubt: it holds until an operator orders run.
        """
        over = now.mono - self._met
        if over > RESTORE_TRIAL_TIME:
            return ""
        self._failed = True
        what = f"failed {over:.1f} s after it took over saved state"
        self._store.write_stops(self._restorer.failed(f"its agent {what}", now))
        if not self._store.written(MAX_LAST_SAVE_WAIT):
            return f"{what}, which stays: a hold cannot be saved"
        aside = self._store.set_state_aside()
        return f"{what}, which {f'is now {aside}' if aside else 'could not be set aside'}"

    def end(self, now: Now) -> None:
        """Save at the end of the agent, or now and then. Never raises."""
        if self._failed or self._restorer.waits:
            return
        try:
            saved = self._restorer.saved(now)
        except Exception as error:  # noqa: BLE001 - whatever it is, the agent drives on
            self._error, self._due = str(error) or type(error).__name__, now.mono + SAVE_PERIOD
            return
        self._error = ""
        self._unsaved = self._unsaved and (self._requested or not self._store.written(0.0))
        # the old state shows the doubt for which the robot holds, until that hold is saved
        if saved is not None and not self._unsaved:
            self._since = min(self._since, now.mono)
            young = now.mono - self._since < SAVE_PERIOD
            self._due = now.mono if young else now.mono + SAVE_PERIOD
            self._store.write_state(saved)
