"""The campaign's harness on real processes: a fair part of its rows, each once."""

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
def moments(request: pytest.FixtureRequest) -> Iterator[None]:
    """What is random in a campaign is here the same each time, so that what fails can be had again."""
    before = random.getstate()
    random.seed(request.node.name)
    yield
    random.setstate(before)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """One that goes through everything: as in the campaign, it has to be well again after each fault."""
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
def test_a_fleet_comes_through_a_fault_as_the_failure_table_says(fleet: Fleet, name: str) -> None:
    one = attempt(fleet, ROWS[name])
    assert one.wrong == []
    assert one.settles is not None


def test_a_fleet_that_was_parted_comes_together_again(fleet: Fleet) -> None:
    assert attempt(fleet, ROWS["partition"]).wrong == []


def test_shapes_change_while_it_drives(fleet: Fleet) -> None:
    one = attempt(fleet, shapes.ROW)
    assert one.wrong == []
    assert one.figures["nearest"] > 2.0 * load(shapes.MISSION).robot.radius


def test_fleet_converges_with_lost_and_late_packets() -> None:
    found = network.run(Options(tries=1, fields=1, only=("both",)))
    assert found["cells"]["both"]["wrong"] == []


def test_a_stop_reaches_all_that_can_be_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop, "ROBOTS", 4)
    found = stop.run(Options(tries=1))
    assert {name: row["wrong"] for name, row in found["rows"].items()} == {name: {} for name in stop.CASES}


def test_a_row_that_fails_is_counted_as_such_and_named(tmp_path: Path) -> None:
    """A fleet whose follower nobody starts again does not come back, and the try says so."""
    with faults.maker(tmp_path) as fleet:
        fleet.begin()
        dead = ROWS["kill-mid"]._replace(end=lambda _fleet, _victim: None)
        one = attempt(fleet, dead, patience=4.0)
        assert "the error did not come back" in one.wrong
        assert any(word.endswith(" ended") for word in one.wrong)
