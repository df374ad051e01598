"""Playing a recording on a clock that the test sets, and a recording as a film."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.monitor.recording.reader import Recorded, Recording, UnreadableError, read
from formation.monitor.replay import player
from formation.monitor.replay.player import (
    MAX_CATCH_UP_TIME,
    MAX_SPEED,
    MIN_RECORDING_TIME,
    MIN_SPEED,
    Due,
    Film,
    Player,
)
from formation.wire import Sample
from tests.support.monitored import EPOCH, Fleet
from tests.unit.monitor.recording.test_recorder import record, recorder

START = 1000.0
PERIOD = 0.25
MANY = 10_000


@dataclass
class Reel:
    """Messages, numbered in the order of the file."""

    walls: Sequence[float]
    opened: list[float] = field(default_factory=list)

    @property
    def start(self) -> float:
        return min(self.walls)

    @property
    def end(self) -> float:
        return max(self.walls)

    def messages(self, since: float) -> Iterator[Recorded]:
        self.opened.append(since)
        begun = False
        for number, wall in enumerate(self.walls):
            begun = begun or wall >= since
            if begun:
                yield Recorded(Sample("a", b"%d" % number, None, wall), wall)


def reel(seconds: float = 10.0) -> Reel:
    return Reel([START + PERIOD * k for k in range(round(seconds / PERIOD) + 1)])


def numbers(due: Sequence[Due]) -> list[int]:
    return [int(one.message.sample.payload) for one in due]


def played(player: Player, since: float, until: float) -> list[Due]:
    """Everything due from `since` to `until` on the clock, taken ten times a second."""
    steps = round((until - since) / 0.1)
    times = [since + (until - since) * step / max(steps, 1) for step in range(steps + 1)]
    return [due for mono in times for due in player.next_batch(mono, MANY).due]


def test_messages_are_due_at_their_time() -> None:
    player = Player(reel(), 5.0)
    assert numbers(player.next_batch(5.0, MANY).due) == [0]
    assert numbers(player.next_batch(5.1, MANY).due) == []
    assert numbers(player.next_batch(5.55, MANY).due) == [1, 2]
    assert player.position == pytest.approx(START + 0.55)


def test_speed_scales_the_playing_time() -> None:
    player = Player(reel(), 0.0, speed=4.0)
    assert numbers(player.next_batch(0.25, MANY).due) == [0, 1, 2, 3, 4]
    player.set_speed(0.25, 0.5)
    played(player, 0.25, 1.25)
    assert player.position == pytest.approx(START + 1.5)


def test_paused_player_continues_where_it_paused() -> None:
    player = Player(reel(), 0.0)
    played(player, 0.0, 1.0)
    player.pause()
    assert player.next_batch(50.0, MANY).due == []
    assert player.position == START + 1.0
    player.play(50.0)
    assert numbers(player.next_batch(50.25, MANY).due) == [5]


def test_seek_forward_plays_skipped_messages_silently() -> None:
    player = Player(reel(), 0.0)
    player.next_batch(0.0, MANY)
    player.seek(START + 5.0)
    assert player.seeking
    batch = player.next_batch(0.1, MANY)
    assert not batch.restarts
    assert numbers(batch.due) == list(range(1, 21))
    assert [one.played for one in batch.due] == [False] * 19 + [True]
    assert (player.position, player.seeking) == (START + 5.0, False)


def test_seek_back_rebuilds_from_the_beginning() -> None:
    player = Player(reel(), 0.0)
    played(player, 0.0, 8.0)
    player.seek(START + 2.0)
    batch = player.next_batch(8.0, MANY)
    assert batch.restarts
    assert [int(one.message.sample.payload) for one in batch.due if not one.played] == list(range(8))
    assert player.built_from == START
    assert numbers(player.next_batch(8.3, MANY).due) == [9]


def test_seek_back_during_seek_forward_starts_anew() -> None:
    player = Player(reel(), 0.0)
    player.next_batch(0.0, MANY)
    player.seek(START + 9.0)
    assert numbers(player.next_batch(0.1, 30).due) == list(range(1, 31))  # as far as 7.5 s
    player.seek(START + 2.0)
    batch = player.next_batch(0.2, MANY)
    assert batch.restarts
    assert numbers(batch.due) == list(range(9))
    assert player.position == START + 2.0


def test_seek_in_long_recording_rebuilds_from_a_stretch_before() -> None:
    film = reel(100.0)
    player = Player(film, 0.0, stretch=10.0)
    player.seek(START + 60.0)
    batch = player.next_batch(0.0, MANY)
    assert batch.restarts
    assert film.opened == [START, START + 50.0]
    assert numbers(batch.due) == list(range(200, 241))
    assert player.built_from == START + 50.0


def test_long_seek_takes_many_steps_with_clock_paused() -> None:
    player = Player(reel(), 0.0)
    player.seek(START + 9.0)
    for step in range(8):
        assert (player.seeking, player.goal) == (True, START + 9.0)
        player.next_batch(float(step), 5)
    assert (player.seeking, player.position) == (False, START + 9.0)


def test_seek_is_limited_to_the_recording() -> None:
    player = Player(reel(), 0.0)
    player.seek(START + 1e9)
    player.next_batch(0.0, MANY)
    assert (player.position, player.finished) == (START + 10.0, True)
    player.seek(-1e9)
    assert numbers(player.next_batch(0.0, MANY).due) == [0]
    assert player.position == START


def test_play_at_the_end_restarts() -> None:
    player = Player(reel(), 0.0)
    assert len(played(player, 0.0, 10.0)) == 41
    assert player.finished
    player.play(30.0)
    batch = player.next_batch(30.0, MANY)
    assert batch.restarts
    assert numbers(batch.due) == [0]


def test_player_ends_at_until() -> None:
    player = Player(reel(), 0.0, until=START + 3.1)
    assert numbers(played(player, 0.0, 4.0)) == list(range(13))
    assert player.finished
    assert player.position == START + 3.1


def test_late_replay_delays_instead_of_skipping() -> None:
    player = Player(reel(), 0.0, speed=2.0)
    assert numbers(player.next_batch(0.3, 2).due) == [0, 1]
    assert player.position == START + 0.25
    assert numbers(player.next_batch(3.0, MANY).due) == [2]  # not five seconds at once
    assert player.position == START + 0.5
    assert player.lost == pytest.approx(3.0 - 0.25)
    assert numbers(player.next_batch(3.125, MANY).due) == [3]


def test_full_delay_is_reported_near_the_end() -> None:
    player = Player(reel(), 0.0, speed=100.0)
    took = 0.0
    while not player.finished:
        player.next_batch(took, 2)
        took += 0.25
    assert player.lost + player.behind == pytest.approx(took - 10.0 / 100.0, abs=MAX_CATCH_UP_TIME)


def test_player_catches_up_after_short_delay() -> None:
    player = Player(reel(), 0.0)
    player.next_batch(0.0, MANY)
    for mono, most, number, behind in ((0.6, 1, 1, 0.35), (0.7, MANY, 2, 0.2), (0.8, MANY, 3, 0.05)):
        assert numbers(player.next_batch(mono, most).due) == [number]
        assert player.behind == pytest.approx(behind)
    assert player.lost == 0.0


def test_gap_in_the_recording_is_no_delay() -> None:
    player = Player(Reel([START, START + 5.0]), 0.0)
    assert numbers(played(player, 0.0, 5.1)) == [0, 1]
    assert player.lost == 0.0


def test_recording_of_one_message_is_played() -> None:
    player = Player(Reel([START]), 0.0)
    assert numbers(player.next_batch(0.0, MANY).due) == [0]
    assert player.finished


@pytest.mark.parametrize("speed", [0.0, -1.0, MIN_SPEED / 2, MAX_SPEED * 2, float("nan"), float("inf")])
def test_invalid_speed_is_refused(speed: float) -> None:
    player = Player(reel(), 0.0)
    with pytest.raises(ValueError, match=r"must be from 0\.1 to 100"):
        player.set_speed(0.0, speed)
    assert player.speed == 1.0


ACTIONS = st.one_of(
    st.just(("pause", 0.0)),
    st.just(("play", 0.0)),
    st.tuples(st.just("seek"), st.floats(-2.0, 12.0)),
    st.tuples(st.just("speed"), st.floats(MIN_SPEED, MAX_SPEED)),
    st.tuples(st.just("wait"), st.floats(0.0, 3.0)),
    st.tuples(st.just("take"), st.integers(1, 7).map(float)),
)


@given(
    gaps=st.lists(st.floats(-0.1, 1.0), min_size=1, max_size=40),
    actions=st.lists(ACTIONS, max_size=40),
    stretch=st.sampled_from([1.0, 600.0]),
)
def test_messages_keep_order_and_repeat_only_after_seek(
    gaps: list[float], actions: list[tuple[str, float]], stretch: float
) -> None:
    walls = [START]
    for gap in gaps:
        walls.append(max(walls[-1] + gap, START))
    film = Reel(walls)
    player = Player(film, 0.0, stretch=stretch)
    mono, newest, sought = 0.0, -1, False
    for what, value in [*actions, ("wait", 5.0), ("play", 0.0), ("wait", 1.0)]:
        before = player.position
        if what == "pause":
            player.pause()
        elif what == "play":
            sought = sought or player.finished
            player.play(mono)
        elif what == "seek":
            sought = True
            player.seek(START + value)
        elif what == "speed":
            player.set_speed(mono, value)
        else:
            mono += value if what == "wait" else 0.0
            batch = player.next_batch(mono, MANY if what == "wait" else int(value))
            if batch.restarts:
                assert sought
                newest = -1
            came = numbers(batch.due)
            if came:
                # in the order of the file, each once; only a restart may leave some out
                assert came == list(range(came[0], came[0] + len(came)))
                assert came[0] == newest + 1 if newest >= 0 or not sought else came[0] > newest
                newest = came[-1]
            assert not (player.paused and any(one.played for one in batch.due))
            assert all(one.message.wall <= player.position for one in batch.due if one.played)
            if not (sought or batch.restarts):
                assert player.position >= before
            sought = sought and player.seeking
        assert film.start <= player.position <= film.end


@pytest.mark.parametrize("since", [0.0, 10.0, 13.37, 16.0, 18.0, 30.0])
def test_film_starts_at_any_moment(recording: Recording, since: float) -> None:
    film, every = Film(recording), list(recording.messages())
    assert (film.start, film.end) == pytest.approx((every[0].wall, every[-1].wall))
    assert list(film.messages(EPOCH + since)) == [one for one in every if one.wall >= EPOCH + since]


@pytest.mark.parametrize("step", [-60.0, -2.0])
def test_film_plays_evenly_after_clock_set_back(tmp_path: Path, step: float) -> None:
    with recorder(tmp_path / "run.mcap") as one:
        for sample in Fleet().positions(10.0, 20.0):
            one.write(sample, sample.arrived + EPOCH + step * (sample.arrived > 15.0))
            one.flush(sample.arrived)
    film = Film(read(tmp_path / "run.mcap"))
    assert (film.start, film.end) == pytest.approx((EPOCH + 10.0, EPOCH + 20.0), abs=0.1)
    player = Player(film, 0.0)
    each = [len(player.next_batch(tenth / 10.0, MANY).due) for tenth in range(1, 101)]
    assert (min(each), max(each), sum(each)) == pytest.approx((12, 12, 1200), abs=6)
    assert player.finished
    assert next(film.messages(EPOCH + 17.0)).sample.arrived == pytest.approx(EPOCH + 17.0, abs=0.1)


def test_short_recording_is_rebuilt_completely_and_long_partly(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "run.mcap", Fleet().positions(10.0, 50.0), flush=True)
    recording = read(tmp_path / "run.mcap")
    one = Film(recording)
    assert one.stretch == one.end - one.start
    monkeypatch.setattr(player, "MAX_REBUILT_MESSAGES", recording.extent().counts.total() * 3 // 4)
    assert Film(recording).stretch == pytest.approx(30.0, rel=0.01)
    monkeypatch.setattr(player, "MAX_REBUILT_MESSAGES", 1)
    assert Film(recording).stretch == MIN_RECORDING_TIME


def test_film_refuses_a_recording_without_messages(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [])
    with pytest.raises(UnreadableError, match="has no messages"):
        Film(read(tmp_path / "run.mcap"))
