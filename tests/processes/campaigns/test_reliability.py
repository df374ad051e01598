"""The reliability campaign on real processes: some of its rows, one try each."""

from __future__ import annotations

import random
from collections.abc import Iterator

import pytest

from formation.mission.file import load
from tests.campaigns.reliability import faults, network, stop
from tests.campaigns.reliability.campaign import Options
from tests.campaigns.reliability.faults import rows
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.trial import PATIENCE, Row, Try, attempt

pytestmark = [pytest.mark.processes, pytest.mark.namespaces, pytest.mark.timeout(300)]
ROWS = {row.name: row for row in rows(load(faults.MISSION))}


@pytest.fixture(autouse=True)
def seeded_random(request: pytest.FixtureRequest) -> Iterator[None]:
    """Seed `random` by the name of the test, so that a failure can be reproduced."""
    before = random.getstate()
    random.seed(request.node.name)
    yield
    random.setstate(before)


def test_fleet_converges_with_lost_and_late_packets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the module's fleet starts: two fleets at once take minutes to settle on two cores."""
    monkeypatch.setattr(network, "HELD", 3.0)
    found = network.run(Options(tries=1, fields=1, only=("both",)))
    assert found["cells"]["both"]["wrong"] == []


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """Start one fleet for all tests but that of the network: it must recover after each."""
    with faults.maker(tmp_path_factory.mktemp("fleet")) as fleet:
        fleet.begin()
        yield fleet


@pytest.mark.parametrize(
    "name",
    ["kill-leader", "pause-leaf", "unplug-first-hop", "kill-monitor", "kill-watchdog", "clock-10"],
)
def test_fleet_recovers_and_settles_after_fault(fleet: Fleet, name: str) -> None:
    one = repeated(fleet, ROWS[name])
    assert one.wrong == []
    assert one.settles is not None


def repeated(fleet: Fleet, row: Row) -> Try:
    """Attempt it, and once again if something is wrong: a busy machine may pause a process for too long."""
    one = attempt(fleet, row)
    return attempt(fleet, row) if one.wrong else one


def test_attempt_reports_killed_follower_until_it_is_started_again(fleet: Fleet) -> None:
    kill = ROWS["kill-mid"]
    victim = kill.victim(fleet)
    one = attempt(fleet, kill._replace(end=lambda _fleet, _victim: None), patience=4.0)
    kill.end(fleet, victim)
    assert {"the error did not come back", f"{victim} ended"} <= set(one.wrong)
    assert fleet.settles(PATIENCE)
    assert not fleet.lost()


def test_fleet_recovers_after_network_partition(fleet: Fleet) -> None:
    assert repeated(fleet, ROWS["partition"]).wrong == []


def test_stop_reaches_all_robots_but_an_unreachable_one(fleet: Fleet) -> None:
    assert stop.stopped(fleet, "unreachable").wrong == []
