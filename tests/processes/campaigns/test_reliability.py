"""The reliability campaign on real processes: some of its rows, one try each."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from formation.mission.file import load
from tests.campaigns.reliability import faults, network, shapes, stop
from tests.campaigns.reliability.campaign import Options
from tests.campaigns.reliability.faults import rows
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.trial import attempt

pytestmark = [pytest.mark.processes, pytest.mark.namespaces, pytest.mark.timeout(300)]
ROWS = {row.name: row for row in rows(load(faults.MISSION))}


@pytest.fixture(autouse=True)
def seeded_random(request: pytest.FixtureRequest) -> Iterator[None]:
    """Seed `random` by the name of the test, so that a failure can be reproduced."""
    before = random.getstate()
    random.seed(request.node.name)
    yield
    random.setstate(before)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """Start one fleet for all faults: as in the campaign, it must recover after each."""
    with faults.maker(tmp_path_factory.mktemp("fleet")) as fleet:
        fleet.begin()
        yield fleet


@pytest.mark.parametrize(
    "name",
    [
        "kill-leader",
        "kill-mid",
        "pause-leaf",
        "unplug-first-hop",
        "kill-monitor",
        "kill-watchdog",
        "clock-10",
    ],
)
def test_fleet_recovers_and_settles_after_fault(fleet: Fleet, name: str) -> None:
    one = attempt(fleet, ROWS[name])
    assert one.wrong == []
    assert one.settles is not None


def test_fleet_recovers_after_network_partition(fleet: Fleet) -> None:
    assert attempt(fleet, ROWS["partition"]).wrong == []


def test_robots_keep_apart_during_shape_transitions(fleet: Fleet) -> None:
    one = attempt(fleet, shapes.ROW)
    assert one.wrong == []
    assert one.figures["nearest"] > 2.0 * load(shapes.MISSION).robot.radius


def test_fleet_converges_with_lost_and_late_packets() -> None:
    found = network.run(Options(tries=1, fields=1, only=("both",)))
    assert found["cells"]["both"]["wrong"] == []


def test_stop_reaches_all_reachable_robots(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop, "ROBOTS", 4)
    found = stop.run(Options(tries=1))
    assert {name: row["wrong"] for name, row in found["rows"].items()} == {name: {} for name in stop.CASES}


def test_attempt_reports_follower_that_does_not_come_back(tmp_path: Path) -> None:
    """A killed follower that is not started again makes the attempt fail."""
    with faults.maker(tmp_path) as fleet:
        fleet.begin()
        dead = ROWS["kill-mid"]._replace(end=lambda _fleet, _victim: None)
        one = attempt(fleet, dead, patience=4.0)
        assert "the error did not come back" in one.wrong
        assert any(word.endswith(" ended") for word in one.wrong)
