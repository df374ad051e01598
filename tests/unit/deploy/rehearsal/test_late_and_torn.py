"""Late sensors of a robot's surroundings, and states that were written only in part."""

from __future__ import annotations

import pytest

from formation.mission.file import read
from formation.pytest_plugin import MakeRehearsed

LOCAL = read("six_robots")[0].replace("rate = 20 ", 'rate = 20\nmeasurement = "local" #')


@pytest.mark.parametrize(
    ("mission", "fault", "reason"),
    [(LOCAL, "robot3:relative_late=1@6+4", "sensor"), ("posts", "robot3:scan_late=1@6+4", "scan")],
    ids=["relative", "scan"],
)
def test_robot_holds_while_a_sensor_is_late(
    rehearsed_fleet: MakeRehearsed, mission: str, fault: str, reason: str
) -> None:
    fleet = rehearsed_fleet(mission, faults=[fault])
    fleet.run(5.9)
    assert fleet.state("robot3") == "run"
    fleet.run(3.6)
    assert fleet.state("robot3") == "hold"
    assert reason in fleet.reason("robot3")
    before = fleet.position("robot3")
    fleet.run(0.4)
    assert abs(fleet.position("robot3") - before) < 0.01
    fleet.run_until_settled(within=60.0)


def test_robot_with_a_torn_state_starts_anew(
    rehearsed_fleet: MakeRehearsed, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = rehearsed_fleet("six_robots", faults=["robot3:torn@10+2"])
    fleet.run(12.5)
    assert "not written to its end" in caplog.text
    fleet.run_until_settled(within=60.0)
