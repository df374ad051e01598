"""`Air`, the simulated network of a rehearsal."""

from __future__ import annotations

import pytest

from formation.deploy.rehearsal.air import HOP_DELAY, HOP_JITTER, LOCAL_DELAY, MAX_QUEUE_TIME, Air, Weather

CALM = Weather()
QUICK, LATE = HOP_DELAY, HOP_DELAY + HOP_JITTER


def air(weather: Weather = CALM, now: float = 0.0) -> Air:
    return Air(1, lambda: now, weather)


def sent(air: Air, count: int = 1000, size: int = 100) -> list[list[float]]:
    return [list(air.ways("a", "b", size)) for _ in range(count)]


def test_calm_air_carries_each_message_once() -> None:
    assert all(len(ways) == 1 and QUICK <= ways[0] <= LATE for ways in sent(air()))


@pytest.mark.parametrize(("weather", "ordered"), [(Weather(delay=0.2), True), (Weather(jitter=0.01), False)])
def test_messages_of_a_link_overtake_each_other_only_with_jitter(weather: Weather, *, ordered: bool) -> None:
    now, arrived = [0.0], []
    link = Air(1, lambda: now[0], weather)
    for number in range(1000):
        now[0] = 0.0001 * number
        (way,) = link.ways("a", "b", 100)
        arrived.append(now[0] + way)
    assert (arrived == sorted(set(arrived))) is ordered


def test_message_within_one_machine_has_only_local_delay() -> None:
    assert list(air(Weather(loss=1.0)).ways("a", "a", 100)) == [LOCAL_DELAY]


def test_loss_and_twice_apply_to_given_shares() -> None:
    counts = [len(ways) for ways in sent(air(Weather(loss=0.3, twice=0.5)), 4000)]
    assert counts.count(0) / 4000 == pytest.approx(0.3, abs=0.04)
    assert counts.count(2) / 4000 == pytest.approx(0.35, abs=0.04)


def test_again_delivers_each_message_a_second_time_later() -> None:
    assert all(later == first + 2.0 for first, later in sent(air(Weather(again=2.0))))


def test_growth_increases_delay_since_its_start() -> None:
    (ways,) = sent(air(Weather(growth=0.5, since=5.0), now=7.0), 1)
    assert 1.0 + QUICK <= ways[0] <= 1.0 + LATE


def test_disturb_affects_one_machine_until_calm() -> None:
    local, storm = air(), Weather(delay=1.0)
    local.disturb("b", storm)
    assert sent(local, 1)[0][0] > 1.0
    assert next(local.ways("a", "c", 100)) < 1.0
    local.calm("b", storm)
    assert sent(local, 1)[0][0] < 1.0


def test_link_cut_twice_needs_two_mends() -> None:
    twice = air()
    twice.cut([("a", "b")])
    twice.cut([("a", "b")])
    twice.mend([("a", "b")])
    assert sent(twice, 1) == [[]]
    assert len(list(twice.ways("b", "a", 100))) == 1
    twice.mend([("a", "b")])
    assert len(sent(twice, 1)[0]) == 1


def test_bandwidth_limit_queues_messages_and_then_drops_them() -> None:
    ways = sent(air(Weather(bandwidth=1000.0)), 100)
    delays = [one[0] for one in ways if one]
    assert delays == sorted(delays)
    assert MAX_QUEUE_TIME - 0.1 <= max(delays) <= MAX_QUEUE_TIME + LATE
    assert ways[-1] == []
