"""A replay in turns: what page and listeners receive, and steering from other threads."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from formation.mission.file import load
from formation.monitor.metrics.event import Event, to_message
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.recording.reader import Recorded
from formation.monitor.replay import process as loop
from formation.monitor.replay.echo import Echo
from formation.monitor.replay.player import Batch, Player
from formation.monitor.replay.process import Replay
from formation.monitor.web import frames
from formation.monitor.web.source import Source
from formation.ros2.messages import Number, encode
from formation.topics import ERROR, EVENTS, Topic
from formation.wire import Now, Sample
from tests.support.monitored import EPOCH, Fleet

SIX = load("six_robots")
BEGIN, END = EPOCH + 10.0, EPOCH + 14.0


class Reel:
    """Four seconds of six robots, with the error and an event every second."""

    start, end = BEGIN, END

    def __init__(self) -> None:
        samples = Fleet().positions(10.0, 14.0)
        for second in range(5):
            event = Event(BEGIN + second, 20, "", "reported", f"second {second}")
            samples.append(Sample(EVENTS.key(), encode(to_message(event)), None, 10.0 + second))
        for tenth in range(41):
            samples.append(Sample(ERROR.key(), encode(Number(1.0 / (1 + tenth))), None, 10.0 + tenth / 10))
        walls = sorted(samples, key=lambda one: one.arrived)
        self.all = [Recorded(s._replace(arrived=s.arrived + EPOCH), s.arrived + EPOCH) for s in walls]

    def messages(self, since: float) -> Iterator[Recorded]:
        return (one for one in self.all if one.wall >= since)


class Clock:
    """The loop's clock, set by the test."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(loop, "time", clock)
    return clock


def page() -> Source:
    source = Source(frames.hello(SIX, live=False, control=False, version="0"), lambda: BEGIN)
    source.set_clients(1)
    return source


def turns(replay: Replay, clock: Clock, seconds: float) -> None:
    end = clock.now + seconds
    while clock.now < end:
        clock.now = min(clock.now + 0.01, end)
        replay.turn()


def shown(source: Source) -> dict[str, Any]:
    assert source.look is not None
    return dict(source.look.frame)


def test_replay_frame_equals_metrics_of_recorded_messages(clock: Clock) -> None:
    source, reel = page(), Reel()
    replay = Replay(SIX, Player(reel, 0.0), source)
    turns(replay, clock, 1.5)
    metrics = Metrics(SIX)
    at = shown(source)["replay"]["t"]
    for sample, wall in (one for one in reel.all if one.wall <= at):
        if sample.key == ERROR.key():
            metrics.observe(Now(wall, wall))
        elif sample.key != EVENTS.key():
            metrics.process_sample(sample, wall)
    expected = frames.frame(SIX, metrics, Now(at, at))
    assert {key: shown(source)[key] for key in expected} == expected


def test_page_follows_history_and_is_rebuilt_after_seek(clock: Clock) -> None:
    source = page()
    replay = Replay(SIX, Player(Reel(), 0.0), source)
    turns(replay, clock, 2.5)
    epoch = source.epoch
    assert source.events(0)[0] == 3
    replay.step("seek", BEGIN + 1.2)
    turns(replay, clock, 0.02)
    assert source.epoch == epoch + 1  # viewers get a new greeting
    assert source.events(0)[0] == 2
    assert b"second 1" in source.greeting().chunk
    assert b"second 2" not in source.greeting().chunk
    turns(replay, clock, 1.0)
    assert source.events(0)[0] == 3


def test_page_times_are_positions_after_clock_was_set() -> None:
    picture = loop.Picture(SIX)
    event = Event(BEGIN - 60.0, 20, "", "reported", "after the clock was set back")
    for key, message in ((EVENTS.key(), to_message(event)), (ERROR.key(), Number(0.5))):
        picture.process_message(Recorded(Sample(key, encode(message), None, BEGIN), BEGIN - 60.0))
    assert [event.at for _, event in picture.events] == [BEGIN]
    assert list(picture.history) == [(BEGIN, 0.5)]


def test_every_frame_contains_replay_position_even_when_paused(
    clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = page()
    stepped = []
    monkeypatch.setattr(source, "step", lambda: stepped.append(1))
    replay = Replay(SIX, Player(Reel(), 0.0, paused=True), source)
    replay.step("speed", 2.0)
    turns(replay, clock, 0.3)
    state = shown(source)["replay"]
    assert state["t"] == state["start"] == BEGIN
    assert (state["end"], state["speed"], state["paused"]) == (END, 2.0, True)
    number = source.look.number if source.look else 0
    turns(replay, clock, 1.0)
    assert source.look is not None
    assert 8 <= source.look.number - number <= 11
    assert len(stepped) >= source.look.number


def test_frames_during_seek_show_target_and_last_state(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    source, player = page(), Player(Reel(), 0.0, paused=True)
    replay = Replay(SIX, player, source)
    turns(replay, clock, 0.2)
    before = shown(source)

    def one_by_one(mono: float, _most: int) -> Batch:
        return Player.next_batch(player, mono, 1)

    monkeypatch.setattr(player, "next_batch", one_by_one)
    replay.step("seek", BEGIN + 1.0)
    seen = []
    while replay.state.seeking:
        clock.now += 0.11
        replay.turn()
        seen.append(shown(source))
    arrived = seen.pop()
    assert len(seen) > 20
    for frame in seen:
        assert (frame["replay"]["seeking"], frame["replay"]["t"]) == (True, BEGIN + 1.0)
        assert {**frame, "replay": before["replay"]} == before
    assert (arrived["replay"]["seeking"], arrived["t"]) == (False, BEGIN + 1.0)


def test_replay_with_loop_from_restarts_at_the_end(clock: Clock) -> None:
    replay = Replay(SIX, Player(Reel(), 0.0), loop_from=BEGIN + 1.0)
    for _ in range(450):
        turns(replay, clock, 0.01)
        assert not replay.state.finished  # at no moment, or the replay would end
    assert BEGIN + 1.3 < replay.state.position < BEGIN + 1.6


class Listener:
    """A listener that takes `takes` seconds for each message."""

    def __init__(self, clock: Clock, takes: float) -> None:
        self.clock, self.takes, self.received = clock, takes, 0
        self.echo = Echo(SIX, "replay", self.advertise, self.publish)

    def advertise(self, _topic: Topic, _key: str) -> None: ...

    def publish(self, _key: str, _payload: bytes, _attachment: bytes | None) -> None:
        self.received += 1
        self.clock.now += self.takes


@pytest.mark.parametrize(("speed", "skips"), [(1.0, False), (10.0, True)])
def test_only_fast_replay_skips_messages_for_slow_listener(clock: Clock, speed: float, skips: bool) -> None:
    listener, reel = Listener(clock, 0.02), Reel()
    replay = Replay(SIX, Player(reel, 0.0, speed=speed), echo=listener.echo)
    while not replay.state.finished:
        turns(replay, clock, 0.01)
    assert replay.state.played == len(reel.all)  # skipped ones are in the metrics
    assert (replay.state.skipped > 0) is skips
    assert listener.received == len(reel.all) - replay.state.skipped
    assert skips or replay.state.drift > 3.0


@pytest.mark.parametrize(
    ("do", "to", "why"),
    [("speed", 1000.0, "from 0.1 to 100"), ("speed", None, "must be a number"),
     ("seek", None, "must be a number")],
)  # fmt: skip
def test_invalid_steering_is_refused_in_another_thread(do: str, to: float | None, why: str) -> None:
    replay = Replay(SIX, Player(Reel(), time.monotonic(), paused=True))
    with ThreadPoolExecutor() as threads:
        steered = threads.submit(replay.steer, do, to)
        while not steered.done():
            replay.turn()
    with pytest.raises(ValueError, match=why):
        steered.result()


def test_steering_thread_gets_the_new_state() -> None:
    replay = Replay(SIX, Player(Reel(), time.monotonic(), paused=True))
    with ThreadPoolExecutor() as threads:
        steered = threads.submit(replay.steer, "seek", BEGIN + 2.0)
        while not steered.done():
            replay.turn()
    assert steered.result()["t"] == BEGIN + 2.0
    assert replay.state.position == BEGIN + 2.0
