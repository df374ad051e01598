"""A recording on its way to the page and onto the bus, in turns of a few hundredths of a second.

Whoever steers does so from any thread; what is asked is done at the beginning of the next turn. The figures
have precedence: of a recording that is played faster than this machine can, all messages are in the figures,
but those that come late are not said any more.
"""

from __future__ import annotations

import time
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

from formation.mission import Mission
from formation.rate import Rate
from formation.wire import Now
from monitor.figures.snapshot import Snapshot
from monitor.page import frames
from monitor.page.source import Source
from monitor.replay.echo import Echo
from monitor.replay.picture import Picture
from monitor.replay.player import FASTEST, SLOWEST, Player

TURN = 0.05
"""Longest time that a turn takes messages in [s]."""
BATCH = 100
"""Messages between two looks at the clock."""
SHORTEST, LONGEST = 0.001, 0.02
"""Between two turns [s]."""
LATE = 0.2
"""Faster than it was, a message that comes later than this is not said any more [s, real]."""
FRAMES = 10.0
"""[Hz]"""
ANSWER = 2.0
"""How long who steers waits for the turn in which it is done [s]."""
Order = tuple[str, float | None, "Future[dict[str, Any]]"]


@dataclass(frozen=True, slots=True)
class Standing:
    """How a replay stands. Times of the recording are on its recorder's system clock [s]."""

    position: float
    start: float
    end: float
    speed: float
    paused: bool
    seeking: bool
    finished: bool
    counted_from: float
    """Since when settling and counts are known: later than the start after a seek into a long recording."""
    drift: float
    """How much longer it has taken than was asked [s, real]."""
    played: int
    """Messages so far, every repetition counted."""
    said: int
    """Those that were said on the bus …"""
    skipped: int
    """… and those that came too late for that."""

    def as_json(self) -> dict[str, Any]:
        """As a frame has it, and who steers is answered."""
        return {
            "t": round(self.position, 3),
            "start": round(self.start, 3),
            "end": round(self.end, 3),
            "speed": self.speed,
            "paused": self.paused,
            "seeking": self.seeking,
            "finished": self.finished,
            "counted_from": round(self.counted_from, 3),
            "drift": round(self.drift, 3),
            "skipped": self.skipped,
        }


class Replay:
    """Plays one recording. `steer` may be called from any thread, all else from one."""

    def __init__(
        self,
        mission: Mission,
        player: Player,
        source: Source | None = None,
        echo: Echo | None = None,
        again_from: float | None = None,
    ) -> None:
        """`source` is the page's, `echo` leads onto the bus.

        At its end it goes on from `again_from` [s, the recorder's system clock], if that is given.
        """
        self._mission, self._player = mission, player
        self._source, self._echo, self._again_from = source, echo, again_from
        self._picture = Picture(mission)
        self._orders: SimpleQueue[Order] = SimpleQueue()
        self._frames = Rate(FRAMES)
        self._played = self._skipped = 0
        self._shown = self._picture.end

    @property
    def standing(self) -> Standing:
        """How it stands."""
        one = self._player
        return Standing(
            one.goal, one.start, one.end, one.speed, one.paused, one.seeking, one.finished, one.built_from,
            one.lost + one.behind, self._played, self._echo.said if self._echo else 0, self._skipped,
        )  # fmt: skip

    @property
    def snapshot(self) -> Snapshot:
        """The figures at the position."""
        return self._picture.snapshot(self._player.position)

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        """Pause, play, seek to a time [s, the recorder's system clock] or set the speed; how it stands then.

        Raises ValueError for what cannot be.
        """
        if do in {"seek", "speed"} and to is None:
            raise ValueError(f"{do}: where to? `to` must be a number")
        if do == "speed" and not SLOWEST <= (to or 0.0) <= FASTEST:
            raise ValueError(f"speed {to:g}: must be from {SLOWEST:g} to {FASTEST:g}")
        done: Future[dict[str, Any]] = Future()
        self._orders.put((do, to, done))
        with suppress(TimeoutError):
            return done.result(ANSWER)
        return self.standing.as_json()

    def step(self, do: str, to: float | None = None) -> None:
        """The same for the thread that has the turns: done at once."""
        mono, player = time.monotonic(), self._player
        if do == "pause":
            player.pause()
        elif do == "play":
            player.play(mono)
        elif do == "seek":
            player.seek(player.start if to is None else to)
        elif do == "speed":
            player.set_speed(mono, 1.0 if to is None else to)
        else:
            raise ValueError(f"do {do!r}: must be one of pause, play, seek, speed")

    def turn(self) -> float:
        """Do what was asked, take what is due, show it; how long the next turn can wait [s].

        Returns after little more than `TURN`.
        """
        self._obey()
        was_seeking = self._player.seeking
        self._feed()
        if self._source is not None:
            if self._player.seeking:
                self._bridge(self._source)
            else:
                self._show(self._source, anew=was_seeking)
        if self._again_from is not None and self._player.finished and not self._player.paused:
            self._player.seek(self._again_from)
        return min(max(self._player.idle(time.monotonic()), SHORTEST), LONGEST)

    def _obey(self) -> None:
        with suppress(Empty):
            while True:
                do, to, done = self._orders.get_nowait()
                try:
                    self.step(do, to)
                    done.set_result(self.standing.as_json())
                except ValueError as error:
                    done.set_exception(error)

    def _feed(self) -> None:
        end = time.monotonic() + TURN
        while (mono := time.monotonic()) < end:
            lost = self._player.lost
            batch = self._player.take(mono, BATCH)
            behind = self._player.behind > LATE or self._player.lost > lost
            late = behind and self._player.speed > 1.0
            if batch.anew:
                self._picture = Picture(self._mission)
            for message, aloud in batch.due:
                self._picture.take(message)
                self._played += aloud
                if aloud and self._echo is not None:
                    if late:
                        self._skipped += 1
                    else:
                        self._echo.say(message.sample)
            if len(batch.due) < BATCH:
                return

    def _bridge(self, source: Source) -> None:
        """On the way to a position: what was shown last, and where this leads, for who looks meanwhile."""
        last = source.look
        if last is not None and source.wanted and self._frames.tick(time.monotonic()):
            source.show({**last.frame, "replay": self.standing.as_json()}, last.snapshot)

    def _show(self, source: Source, *, anew: bool) -> None:
        picture = self._picture
        if anew:
            source.restart(picture.history, (frames.event(*one) for one in picture.events))
        else:
            events, errors = picture.news(self._shown)
            for error in errors:
                source.observe(*error)
            for event in events:
                source.note(frames.event(*event))
        self._shown = picture.end
        if source.wanted and self._frames.tick(time.monotonic()):
            at = self._player.position
            snapshot = picture.snapshot(at)
            frame = frames.frame(
                self._mission, picture.metrics, Now(at, at),
                snapshot=snapshot, replay=self.standing.as_json(),
            )  # fmt: skip
            source.show(frame, snapshot)
