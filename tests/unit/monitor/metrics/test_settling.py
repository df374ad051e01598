from __future__ import annotations

from formation.monitor.metrics.settling import DWELL_TIME, MAX_UNKNOWN_TIME, Settling


def observed(*errors: tuple[float, float]) -> Settling:
    settling = Settling(0.05)
    for at, error in errors:
        settling.observe(at, error)
    return settling


def every_tenth(start: float, end: float, error: float) -> list[tuple[float, float]]:
    return [(start + i / 10, error) for i in range(round((end - start) * 10) + 1)]


def test_an_error_that_rises_again_has_not_settled_the_first_time() -> None:
    settling = observed(
        *every_tenth(0.0, 1.0, 0.5), *every_tenth(1.1, 3.0, 0.01), (3.1, 0.06), *every_tenth(3.2, 9.0, 0.01)
    )
    assert settling.settled_at(9.0) == 3.2


def test_the_threshold_itself_is_not_under_it() -> None:
    assert observed((0.0, 0.05)).settled_at(0.0) is None


def test_it_takes_the_dwell_time_to_converge() -> None:
    assert not observed(*every_tenth(0.0, DWELL_TIME - 0.1, 0.01)).converged(DWELL_TIME - 0.1)
    assert observed(*every_tenth(0.0, DWELL_TIME, 0.01)).converged(DWELL_TIME)


def test_a_long_stretch_of_not_knowing_begins_the_count_anew() -> None:
    long_ago = every_tenth(0.0, 5.0, 0.01)
    assert (
        observed(*long_ago, (5.0 + MAX_UNKNOWN_TIME + 0.1, 0.01)).settled_at(6.1)
        == 5.0 + MAX_UNKNOWN_TIME + 0.1
    )
    assert observed(*long_ago, (5.0 + MAX_UNKNOWN_TIME - 0.1, 0.01)).settled_at(5.9) == 0.0


def test_nothing_is_settled_that_was_never_seen() -> None:
    settling = observed()
    assert settling.settled_at(0.0) is None
    assert settling.final(0.0) is None
    assert not settling.converged(0.0)
