"""The error over the edges that are known, when a robot is silent."""

from __future__ import annotations

import json
import math

import pytest

from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.settling import KnownError, KnownSettling, KnownVerdict
from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.metrics.words import as_json, diagnostics, line
from tests.support.monitored import Fleet, now, receive


def watched(fleet: Fleet, *, silent: str, since: float, until: float) -> tuple[Metrics, Snapshot]:
    """The fleet heard from 10 s to `until`, one robot only to `since`."""
    metrics = Metrics(fleet.mission)
    gone = {
        sample for sample in fleet.positions(10.0, until) if silent in sample.key and sample.arrived > since
    }
    samples = [sample for sample in fleet.positions(10.0, until) if sample not in gone]
    for tick in range(1, round((until - 10.0) * 10) + 1):
        end = 10.0 + tick / 10
        receive(metrics, [one for one in samples if end - 0.1 < one.arrived <= end])
        metrics.observe(now(end))
    return metrics, metrics.snapshot(now(until))


def test_one_silent_robot_leaves_the_other_edges_known() -> None:
    _, seen = watched(Fleet(), silent="robot6", since=15.0, until=30.0)
    assert seen.formation_error is None
    assert seen.known.error == pytest.approx(0.0, abs=1e-9)
    assert (seen.known.known_edges, seen.known.edges) == (7, 9)
    assert list(seen.known.silent) == ["robot6"]
    assert seen.known.silent["robot6"] == pytest.approx(15.0, abs=0.1)
    assert seen.known.words == "7 of 9 edges; 2 unknown (robot6 silent for 15 s)"


def test_survivors_converge_over_the_known_edges() -> None:
    _, seen = watched(Fleet(), silent="robot6", since=15.0, until=30.0)
    assert not seen.converged  # of the whole formation nothing is known
    assert seen.known_verdict.converged
    assert seen.known_verdict.settled_at == pytest.approx(0.0, abs=0.3)
    assert seen.known_verdict.final is not None
    assert seen.known_verdict.final.known_edges == 7


def test_survivors_that_are_off_do_not_settle() -> None:
    fleet = Fleet(away=lambda robot, _: 0.2 + 0j if robot == "robot4" else 0j)
    _, seen = watched(fleet, silent="robot6", since=15.0, until=30.0)
    assert seen.known.error is not None
    assert seen.known.error > 0.3
    assert (seen.known_verdict.converged, seen.known_verdict.settled_at) == (False, None)


def test_known_error_equals_total_while_all_are_fresh() -> None:
    _, seen = watched(Fleet(), silent="robot6", since=99.0, until=20.0)
    assert seen.known.complete
    assert seen.known.error == seen.formation_error
    assert seen.known_verdict.settled_at == seen.settled_at
    assert seen.known_verdict.converged is seen.converged is True


def test_robot_that_was_never_heard_is_named() -> None:
    _, seen = watched(Fleet(), silent="robot6", since=0.0, until=15.0)
    assert seen.known.words == "7 of 9 edges; 2 unknown (nothing from robot6 yet)"
    assert seen.known_verdict.converged


def test_edges_of_a_robot_that_returns_count_again() -> None:
    fleet = Fleet()
    metrics, _ = watched(fleet, silent="robot6", since=12.0, until=16.0)
    receive(metrics, fleet.positions(16.0, 17.0))
    metrics.observe(now(17.0))
    assert metrics.snapshot(now(17.0)).known.complete


def test_nothing_is_known_when_all_are_silent() -> None:
    metrics, _ = watched(Fleet(), silent="robot6", since=15.0, until=20.0)
    seen = metrics.snapshot(now(60.0))
    assert (seen.known.error, seen.known.known_edges) == (None, 0)
    assert seen.known_verdict.final is not None  # the verdict outlives the run
    assert seen.known_verdict.final.known_edges == 7


def test_verdict_is_over_the_most_edges_of_the_last_seconds() -> None:
    """Robots that end at the end of a run do not end at once."""
    settling = KnownSettling(0.05, 0.5)
    for tick in range(50):
        settling.observe(tick / 10, KnownError(0.01, 8, 9), formed=True)
    settling.observe(5.0, KnownError(0.001, 1, 9), formed=True)
    verdict = settling.verdict(5.0, None)
    assert verdict == KnownVerdict(0.0, True, KnownError(0.01, 8, 9))


def test_words_say_over_how_many_edges() -> None:
    _, seen = watched(Fleet(), silent="robot6", since=15.0, until=30.0)
    over = "7 of 9 edges; 2 unknown (robot6 silent for 15 s)"
    assert f"error 0.0 mm over {over}  settled at 0." in line(seen)
    status = next(diagnostics(seen, 1.0)).statuses[0]
    values = dict(status.values)
    assert status.message == f"error 0.0000 m over {over}"
    assert (values["error"], values["known_edges"], values["edges"]) == ("unknown", "7", "9")
    result = json.loads(json.dumps(as_json(seen)))
    assert (result["formation_error"], result["converged"]) == (None, False)
    assert (result["known"]["known_edges"], result["known"]["edges"], result["known"]["converged"]) == (
        7,
        9,
        True,
    )
    assert result["known"]["silent"].keys() == {"robot6"}
    assert result["robots"]["robot5"]["error"] is not None
    assert result["robots"]["robot6"]["known"] == [None, 0, 2]


def test_json_of_a_verdict_is_read_back() -> None:
    verdict = KnownVerdict(1.25, True, KnownError(0.012, 8, 11, {"robot4": 12.3, "robot5": None}))
    assert KnownVerdict.of_json(json.loads(json.dumps(verdict.as_json()))) == verdict
    assert verdict.final is not None
    assert verdict.final.words == "8 of 11 edges; 3 unknown (robot4 silent for 12 s, nothing from robot5 yet)"


def test_known_edges_are_judged_alone() -> None:
    """As a recording is read, which holds no error while an edge is unknown."""
    fleet, metrics = Fleet(), Metrics(Fleet().mission)
    for tick in range(1, 51):
        end = 10.0 + tick / 10
        receive(metrics, fleet.positions(end - 0.1, end, without="robot6"))
        metrics.observe(now(end), known_only=True)
    seen = metrics.snapshot(now(15.0))
    assert seen.known_verdict.converged
    assert (seen.settled_at, seen.final_error) == (None, None)


def test_partial_sum_is_no_formation_error_anywhere() -> None:
    """What is called the formation error stays unknown, and is not published as a number."""
    _, seen = watched(Fleet(), silent="robot6", since=15.0, until=30.0)
    assert seen.formation_error is None
    assert seen.final_error is None
    assert math.isclose(seen.known.error or 0.0, 0.0, abs_tol=1e-9)
