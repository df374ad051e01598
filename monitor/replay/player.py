"""The position in a recording being played, and its due messages: a clock that can be set.

A position is a time of the recording [s, its recorder's system clock as if it had not been set]. It
follows the caller's monotonic clock at the requested speed; it stands while paused. Seeking forward skips the
messages between, seeking back starts again, as the metrics depend on all messages so far: from the beginning
or, if that is more than a stretch, from a stretch before the position. Positions never run ahead of the
messages: a player that cannot keep up falls behind and reports by how much, instead of skipping.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import dropwhile
from typing import NamedTuple, Protocol

from formation.monitor.recording.reader import Recorded, Recording, UnreadableError

MAX_REBUILT_MESSAGES = 50_000
"""Number of messages that can be skipped without a long wait: in one to three seconds."""
MIN_RECORDING_TIME = 8.0
"""Least recording time from which a moment's metrics are computed, except settling and counts [s]."""
MIN_SPEED, MAX_SPEED = 0.1, 100.0
"""Speeds [s of the recording per s]."""
MAX_CATCH_UP_TIME = 0.5
"""Longest lag that the player tries to catch up [s, real]; more is time lost."""


class Playable(Protocol):
    """What a player plays."""

    @property
    def start(self) -> float:
        """Time of the first message [s]."""

    @property
    def end(self) -> float:
        """Time of the last message [s]."""

    def messages(self, since: float) -> Iterator[Recorded]:
        """Yield every message from the first one at or after `since` [s], in the order of the file."""


class Film:
    """One recording for playing: a `Playable`."""

    def __init__(self, recording: Recording) -> None:
        """Raises UnreadableError for a recording without any messages."""
        extent = recording.extent()
        if extent.start is None or extent.end is None:
            raise UnreadableError(f"{recording.path}: has no messages")
        self.start = extent.start
        """Time of the first message [s, the recorder's system clock]."""
        self.end = extent.end
        """Time of the last message [s]."""
        self._steady = extent.steady
        share = min(1.0, MAX_REBUILT_MESSAGES / max(extent.counts.total(), 1))
        self.stretch = max(MIN_RECORDING_TIME, share * (self.end - self.start))
        """Longest time of it that may be skipped at once [s]."""
        self._recording = recording

    def messages(self, since: float) -> Iterator[Recorded]:
        """Yield messages as a `Playable` does."""
        messages = self._recording.messages(since if self._steady else -math.inf)
        return dropwhile(lambda message: message.sample.arrived < since, messages)


class Due(NamedTuple):
    """One due message."""

    message: Recorded
    played: bool
    """Whether it is played; if not, it is only passed on the way to the sought position."""


class Batch(NamedTuple):
    """The messages to handle now."""

    restarts: bool
    """Whether the metrics start again before these messages."""
    due: list[Due]


class Player:
    """Player of one film. Times called `mono` are of the caller's monotonic clock [s], and never go back."""

    def __init__(
        self,
        film: Playable,
        mono: float,
        *,
        speed: float = 1.0,
        paused: bool = False,
        stretch: float = 600.0,
        until: float = math.inf,
    ) -> None:
        """Begin at the start of `film`, which ends at `until` [s] at the latest.

        At most `stretch` [s] of it are skipped on the way to a position. Raises ValueError for an invalid
        speed.
        """
        self.start = film.start
        self.end = max(min(film.end, until), film.start)
        self.position = film.start
        """Position [s]: all earlier messages have been handed out."""
        self.built_from = film.start
        """Since when the metrics count [s]: later than the start after a seek into a long recording."""
        self.speed = _checked(speed)
        self.paused = paused
        self.behind = 0.0
        """How far the position is behind the clock now [s, real]."""
        self.lost = 0.0
        """Additional playing time because the player could not keep up [s, real]."""
        self.seeks = 0
        """How often a position was sought."""
        self._film, self._stretch = film, stretch
        self._anchor = mono, film.start
        self._target: float | None = None
        self._restarts = False
        self._messages = film.messages(film.start)
        self._next = next(self._messages, None)

    @property
    def seeking(self) -> bool:
        """Whether it is still on its way to a sought position."""
        return self._target is not None

    @property
    def goal(self) -> float:
        """The sought position, or else the current one [s]."""
        return self.position if self._target is None else self._target

    @property
    def finished(self) -> bool:
        """Whether all messages have been handed out."""
        over = self._next is None or self._next.sample.arrived > self.end
        return over and self.position >= self.end and not self.seeking

    def pause(self) -> None:
        """Pause at the position."""
        self.paused, self.behind = True, 0.0

    def play(self, mono: float) -> None:
        """Go on from the position; at the end, from the beginning."""
        if self.finished:
            self.seek(self.start)
        self.paused = False
        self._anchor = mono, self.position

    def set_speed(self, mono: float, speed: float) -> None:
        """Go on at another speed. Raises ValueError for an invalid one."""
        self.speed, self.behind = _checked(speed), 0.0
        self._anchor = mono, self.position

    def seek(self, to: float) -> None:
        """Go to a position [s], limited to the film. Pausing and speed stay as they are."""
        target = min(max(to, self.start), self.end)
        near = self.position <= target <= self.position + self._stretch
        if self._restarts or (self.seeking and target < self.goal) or not near:
            self._restart_at(target)
        self._target, self.behind = target, 0.0
        self.seeks += 1

    def next_batch(self, mono: float, max_messages: int) -> Batch:
        """Return the messages due at `mono`, in order: at most `max_messages`; if as many, call again."""
        restarts, self._restarts = self._restarts, False
        due: list[Due] = []
        if self._target is not None:
            due = self._skip_to(mono, self._target, max_messages)
        if not self.seeking and not self.paused:
            due += self._play(mono, max_messages - len(due))
        return Batch(restarts, due)

    def idle(self, mono: float) -> float:
        """Return the time until a message is due if nothing steers it [s, real]; infinite while paused."""
        if self.seeking:
            return 0.0
        if self._next is None or self.paused:
            return math.inf
        since, begin = self._anchor
        return max(since + (self._next.sample.arrived - begin) / self.speed - mono, 0.0)

    def _skip_to(self, mono: float, target: float, max_messages: int) -> list[Due]:
        due: list[Due] = []
        while self._next is not None and self._next.sample.arrived < target and len(due) < max_messages:
            due.append(Due(self._next_message(), played=False))
        if len(due) < max_messages:
            self._target, self.position, self._anchor = None, target, (mono, target)
        return due

    def _play(self, mono: float, max_messages: int) -> list[Due]:
        clock = self._clock(mono)
        due: list[Due] = []
        while self._next is not None and self._next.sample.arrived <= clock and len(due) < max_messages:
            due.append(Due(self._next_message(), played=True))
        reached = clock
        if self._next is not None and self._next.sample.arrived <= clock:  # more than fits now
            reached = due[-1].message.sample.arrived if due else self.position
        self.position = max(self.position, reached)
        return due

    def _clock(self, mono: float) -> float:
        """Return the due position, set back to the next message if that has waited too long."""
        since, begin = self._anchor
        clock = begin + (mono - since) * self.speed
        self.behind = 0.0
        if self._next is not None and self._next.sample.arrived <= self.end:
            waits = max(self._next.sample.arrived, self.position)
            self.behind = max(clock - waits, 0.0) / self.speed
            if self.behind > MAX_CATCH_UP_TIME:
                self.lost += self.behind
                self.behind, self._anchor, clock = 0.0, (mono, waits), waits
        return min(clock, self.end)

    def _next_message(self) -> Recorded:
        message = self._next
        assert message is not None  # noqa: S101 - for the type checker: checked by the caller
        self._next = next(self._messages, None)
        return message

    def _restart_at(self, target: float) -> None:
        since = self.start if target - self.start <= self._stretch else target - self._stretch
        self._restarts, self.built_from = True, since
        self.position = since
        self._messages = self._film.messages(since)
        self._next = next(self._messages, None)


def _checked(speed: float) -> float:
    if not MIN_SPEED <= speed <= MAX_SPEED:
        raise ValueError(f"speed {speed:g}: must be from {MIN_SPEED:g} to {MAX_SPEED:g}")
    return speed
