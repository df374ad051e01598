"""Settling time of a formation, and the error over known edges while a robot is silent."""

from __future__ import annotations

import json
import math

import pytest

from formation.mission.file import parse, read
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.settling import (
    DWELL_TIME,
    MAX_UNKNOWN_TIME,
    KnownError,
    KnownSettling,
    KnownVerdict,
    Settling,
)
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import as_json, diagnostics, line
from tests.support.monitored import Fleet, driven, now, receive


def observed(*errors: tuple[float, float]) -> Settling:
    settling = Settling(0.05)
    for at, error in errors:
        settling.observe(at, error)
    return settling


def every_tenth(start: float, end: float, error: float = 0.01) -> list[tuple[float, float]]:
    return [(start + i / 10, error) for i in range(round((end - start) * 10) + 1)]


def test_settled_time_restarts_after_error_rises_again() -> None:
    settling = observed(
        *every_tenth(0.0, 1.0, 0.5), *every_tenth(1.1, 3.0), (3.1, 0.06), *every_tenth(3.2, 9.0)
    )
    assert settling.settled_at(9.0) == 3.2


def test_error_equal_to_the_bound_is_not_settled() -> None:
    assert observed((0.0, 0.05)).settled_at(0.0) is None


def test_formation_converges_after_the_dwell_time() -> None:
    assert not observed(*every_tenth(0.0, DWELL_TIME - 0.1)).converged(DWELL_TIME - 0.1)
    assert observed(*every_tenth(0.0, DWELL_TIME)).converged(DWELL_TIME)


@pytest.mark.parametrize(("pause", "begin"), [(0.1, 5.0 + MAX_UNKNOWN_TIME + 0.1), (-0.1, 0.0)])
def test_settling_restarts_after_long_unknown_error(pause: float, begin: float) -> None:
    settling = observed(*every_tenth(0.0, 5.0), (5.0 + MAX_UNKNOWN_TIME + pause, 0.01))
    assert settling.settled_at(6.0 + pause) == begin


def test_settling_without_observations_is_not_settled() -> None:
    settling = observed()
    assert (settling.settled_at(0.0), settling.final(0.0), settling.converged(0.0)) == (None, None, False)


def watched(until: float, *, gone: float, fleet: Fleet | None = None) -> Snapshot:
    """Snapshot of a fleet that was received from 10 s to `until`, robot6 only to `gone`."""
    return driven(fleet or Fleet(), until, silent="robot6", gone=gone).snapshot(now(until))


def test_settling_time_counts_from_the_first_complete_error() -> None:
    # 1 m off at first, the error of four edges falls by e^{-t}: under 5 cm after ln(80) s
    fleet = Fleet(away=lambda robot, time: math.exp(-(time - 100.0)) if robot == "robot4" else 0j)
    snapshot = driven(fleet, 110.0, since=100.0).snapshot(now(110.0))
    assert snapshot.settled_at == pytest.approx(math.log(80.0), abs=0.25)
    assert snapshot.converged
    assert snapshot.elapsed == pytest.approx(9.95, abs=0.1)


def test_robot_with_low_rate_does_not_prevent_convergence() -> None:
    text, name = read("six_robots")
    slow = parse(text.replace("[robots.robot4]\n", "[robots.robot4]\nrate = 1\n"), name)
    snapshot = driven(Fleet(slow), 20.0).snapshot(now(20.0))
    assert (snapshot.converged, snapshot.settled_at) == (True, 0.0)


def test_silent_robot_leaves_other_edges_known() -> None:
    seen = watched(30.0, gone=15.0)
    assert seen.formation_error is seen.final_error is seen.settled_at is None
    assert not seen.converged
    assert seen.known.error == pytest.approx(0.0, abs=1e-9)
    assert (seen.known.known_edges, seen.known.edges) == (7, 9)
    assert seen.known.silent == {"robot6": pytest.approx(15.0, abs=0.1)}
    assert seen.known.words == "7 of 9 edges; 2 unknown (robot6 silent for 15 s)"
    verdict = seen.known_verdict
    assert verdict.converged
    assert verdict.settled_at == pytest.approx(0.0, abs=0.3)
    assert verdict.final is not None
    assert verdict.final.known_edges == 7


def test_known_edges_with_large_errors_do_not_settle() -> None:
    fleet = Fleet(away=lambda robot, _: 0.2 + 0j if robot == "robot4" else 0j)
    seen = watched(30.0, gone=15.0, fleet=fleet)
    assert (seen.known.error or 0.0) > 0.3
    assert (seen.known_verdict.converged, seen.known_verdict.settled_at) == (False, None)


def test_known_error_equals_total_while_all_robots_are_fresh() -> None:
    seen = watched(20.0, gone=99.0)
    assert seen.known.complete
    assert seen.known.error == seen.formation_error
    assert seen.known_verdict.settled_at == seen.settled_at
    assert seen.known_verdict.converged is seen.converged is True


def test_edges_of_returned_robot_are_known_again() -> None:
    fleet = Fleet()
    metrics = driven(fleet, 16.0, silent="robot6", gone=12.0)
    assert driven(fleet, 17.0, metrics, 16.0).snapshot(now(17.0)).known.complete


def test_verdict_stays_after_all_robots_end() -> None:
    after = driven(Fleet(), 15.0).snapshot(now(60.0))
    assert (after.formation_error, after.converged) == (None, True)
    assert (after.converged_now, after.verdict_now.converged) == (False, False)
    assert after.final_error == pytest.approx(0.0, abs=1e-9)
    after = driven(Fleet(), 20.0, silent="robot6", gone=15.0).snapshot(now(60.0))
    assert (after.known.error, after.known.known_edges) == (None, 0)
    assert after.known_verdict.final is not None
    assert after.known_verdict.final.known_edges == 7


def test_verdict_uses_the_most_known_edges_of_last_seconds() -> None:
    """At the end of a run, robots end at different moments."""
    settling = KnownSettling(0.05, 0.5)
    for tick in range(50):
        settling.observe(tick / 10, KnownError(0.01, 8, 9), formed=True)
    settling.observe(5.0, KnownError(0.001, 1, 9), formed=True)
    assert settling.verdict(5.0, None) == KnownVerdict(0.0, True, KnownError(0.01, 8, 9))


def test_words_contain_number_of_known_edges() -> None:
    seen = watched(30.0, gone=15.0)
    over = "7 of 9 edges; 2 unknown (robot6 silent for 15 s)"
    assert f"error 0.0 mm over {over}  settled at 0." in line(seen)
    status = next(diagnostics(seen, 1.0)).statuses[0]
    assert status.message == f"error 0.0000 m over {over}"
    assert [status.values[key] for key in ("error", "known_edges", "edges")] == ["unknown", "7", "9"]
    result = json.loads(json.dumps(as_json(seen)))
    assert (result["formation_error"], result["converged"]) == (None, False)
    assert [result["known"][key] for key in ("known_edges", "edges", "converged")] == [7, 9, True]
    assert result["known"]["silent"].keys() == {"robot6"}
    assert result["robots"]["robot5"]["error"] is not None
    assert result["robots"]["robot6"]["known"] == [None, 0, 2]


def test_verdict_is_restored_from_json() -> None:
    verdict = KnownVerdict(1.25, True, KnownError(0.012, 8, 11, {"robot4": 12.3, "robot5": None}))
    assert KnownVerdict.of_json(json.loads(json.dumps(verdict.as_json()))) == verdict
    assert verdict.final is not None
    assert verdict.final.words == "8 of 11 edges; 3 unknown (robot4 silent for 12 s, nothing from robot5 yet)"


def test_known_only_gives_verdict_of_known_edges_alone() -> None:
    """A recording is read like this: it contains no error while an edge is unknown."""
    fleet, metrics = Fleet(), Metrics(Fleet().mission)
    for tick in range(1, 51):
        end = 10.0 + tick / 10
        receive(metrics, fleet.positions(end - 0.1, end, without="robot6"))
        metrics.observe(now(end), known_only=True)
    seen = metrics.snapshot(now(15.0))
    assert seen.known_verdict.converged
    assert (seen.settled_at, seen.final_error) == (None, None)
