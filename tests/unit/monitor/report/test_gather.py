from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from formation.mission.file import parse, read
from formation.monitor.report import summary
from formation.monitor.report.gather import Run
from formation.monitor.report.parts import View
from formation.topics import CMD_VEL, POSITION
from tests.support.monitored import Fleet, command
from tests.support.recordings import START, coming_in, gathered, record, talk


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    record(path, talk(Fleet(away=coming_in), 12.0))
    return gathered(path)


def test_settling_time_and_final_error_are_those_that_the_monitor_told(tmp_path: Path) -> None:
    reported = record(tmp_path / "run.mcap", talk(Fleet(away=coming_in), 12.0))
    found = gathered(tmp_path / "run.mcap").snapshot
    assert reported.settled_at is not None
    assert found.settled_at == pytest.approx(reported.settled_at, abs=1e-6)
    assert found.final_error == reported.final_error
    assert (found.converged, found.missed, found.rejected) == (
        reported.converged,
        reported.missed,
        reported.rejected,
    )


def test_settling_time_of_monitor_equals_that_of_report(run: Run) -> None:
    assert abs(run.apart) < 1e-3
    assert not [notice for notice in summary.notices(run, cut=False) if "clock" in notice]


def test_rms_and_maximum_cover_whole_and_settled_run(run: Run) -> None:
    whole, after = run.error.whole, run.error.after
    # nine edges; robots that are off alike do not count: only the two edges to the leader do
    first = 2.0 * abs(coming_in("robot2", START))
    assert whole.maximum == pytest.approx(first, rel=0.05)
    assert after.maximum is not None
    assert after.maximum < run.mission.settled <= 1.1 * after.maximum
    rms = math.sqrt(first**2 / (2.0 * math.log(2.0) * 12.0))  # of an error that halves every second
    assert whole.rms == pytest.approx(rms, rel=0.05)
    assert run.robots["robot4"].error.whole.maximum == pytest.approx(
        0.0, abs=1e-3
    )  # a bent way, interpolated
    assert run.robots["robot2"].error.whole.maximum == pytest.approx(first / 2.0, rel=0.05)


def test_heading_errors_and_true_error_come_from_ground_truth(run: Run) -> None:
    assert run.truth
    assert run.robots["robot2"].heading.whole.rms == pytest.approx(0.1, abs=1e-6)
    # the truth of a turned robot has its control point elsewhere
    assert run.true_error.final is not None


def test_without_ground_truth_the_run_says_so(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", talk(Fleet(away=coming_in), 4.0, truth=False))
    run = gathered(tmp_path / "run.mcap")
    assert not run.truth
    assert run.true_error.whole.count == 0
    assert run.true_error.final is None
    assert any("No ground truth" in notice for notice in summary.notices(run, cut=False))


def test_delays_are_from_stamps_and_answers_from_odometry(run: Run) -> None:
    assert run.late["position"].median == pytest.approx(0.002, abs=1e-5)
    assert run.late["odom"].median == pytest.approx(0.003, abs=1e-5)
    assert "cmd_vel" not in run.late  # a Twist has no stamp
    answer = run.answers["robot3"]
    assert answer.median == pytest.approx(0.002, abs=1e-5)
    assert answer.count == run.robots["robot3"].commands


def test_a_command_that_answers_no_odometry_is_not_timed(tmp_path: Path) -> None:
    result = [*talk(Fleet(), 2.0), command("robot2", START + 2.5, 0.0, 0.0)]
    record(tmp_path / "run.mcap", result)
    run = gathered(tmp_path / "run.mcap")
    assert run.robots["robot2"].commands == run.answers["robot2"].count + 1


def test_saturation_is_the_share_of_commands_at_the_limit(tmp_path: Path) -> None:
    nearly = 0.95 * parse(read("six_robots")[0], "a test").robots["robot2"].max_speed
    result = [command("robot2", START + 0.05 * i, 1.5 if i < 30 else nearly, -1.5) for i in range(120)]
    record(tmp_path / "run.mcap", result)
    run = gathered(tmp_path / "run.mcap")
    assert run.robots["robot2"].saturated == (0.25, 1.0)
    assert run.robots["robot3"].saturated == (None, None)


def test_gap_without_commands_interrupts_the_line(tmp_path: Path) -> None:
    result = [command("robot2", START + 0.05 * i + (2.0 if i > 20 else 0.0), 0.2, 0.1) for i in range(40)]
    record(tmp_path / "run.mcap", result)
    run = gathered(tmp_path / "run.mcap")
    assert [bool(gap) for gap in np.isnan(run.commands["robot2"].low[:, 0])] == [i == 21 for i in range(41)]


def test_robot_centres_are_offset_from_control_points(run: Run) -> None:
    apart = np.abs(run.paths.points - run.paths.centres)
    offsets = [run.mission.robots[name].control_point_offset for name in run.mission.followers]
    assert apart[-1] == pytest.approx([0.0, *offsets])


def test_silence_at_the_common_end_is_no_loss(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [*talk(Fleet(), 3.0), command("robot2", START + 8.0, 0.0, 0.0)])
    assert summary.lost_robots(gathered(tmp_path / "run.mcap").keys) == []


def test_robot_lost_midway_makes_final_error_unknown(tmp_path: Path) -> None:
    result = [
        s for s in talk(Fleet(away=coming_in), 12.0) if s.arrived < START + 6.0 or "robot5" not in s.key
    ]
    reported = record(tmp_path / "run.mcap", result)
    run = gathered(tmp_path / "run.mcap")
    assert reported.settled_at is None
    assert run.snapshot.settled_at is None
    assert run.snapshot.final_error is None
    assert run.known
    assert [robot for robot, _ in summary.lost_robots(run.keys)] == ["robot5"]
    assert summary.lost_robots(run.keys)[0][1] == pytest.approx(6.0, abs=0.1)
    assert "robot5" in " ".join(summary.notices(run, cut=False))
    assert any(event.kind == "lost" and event.robot == "robot5" for event in run.events)
    numbers = {item.name: item.value for item in summary.items(run)}
    assert (numbers["formation_error"], numbers["formation_error_true"]) == (None, None)
    assert View.of([run]).until > 11.0  # what did not settle is shown to its end
    way = run.paths.points[run.paths.time > 7.0]
    assert np.isnan(way[:, 4]).all()
    assert np.isfinite(way[:, 3]).all()


def test_unknown_formation_error_keeps_other_figures(tmp_path: Path) -> None:
    result = [sample for sample in talk(Fleet(away=coming_in), 4.0) if not sample.key.startswith("robot5")]
    record(tmp_path / "run.mcap", result)
    run = gathered(tmp_path / "run.mcap")
    assert not run.known
    assert run.snapshot.settled_at is None
    assert run.robots["robot2"].error.whole.count > 10
    assert np.isfinite(run.paths.points[:, 1]).any()
    assert "never known" in summary.verdict(run)
    assert "Never received: robot5" in " ".join(summary.notices(run, cut=False))


def test_an_empty_recording_is_a_run_of_nothing(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", [])
    path = tmp_path / "run.mcap"
    run = gathered(path)
    assert not run.known
    assert summary.verdict(run) in {
        "Nothing was recorded.",
        "The formation error was never known: positions of some robot are missing.",
    }


def test_a_cut_recording_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    record(path, talk(Fleet(away=coming_in), 12.0))
    whole = gathered(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    run = gathered(path)
    assert run.recording.is_cut()
    assert 0 < run.messages < whole.messages
    assert run.error.whole.maximum == whole.error.whole.maximum
    assert any("cut" in notice for notice in summary.notices(run, cut=True))


def test_orders_and_events_are_told_in_time(tmp_path: Path) -> None:
    fleet = Fleet()
    first = talk(fleet, 3.0)
    fleet.shape = "wedge"
    later = [sample for sample in talk(fleet, 6.0) if sample.arrived > first[-1].arrived + 0.05]
    record(tmp_path / "run.mcap", [*first, *later])
    run = gathered(tmp_path / "run.mcap")
    assert [(order.mode, order.wish.shape) for order in run.orders] == [("run", "hexagon"), ("run", "wedge")]
    assert run.orders[1].at - run.start == pytest.approx(3.0, abs=0.3)
    assert {"joined", "order"} <= {event.kind for event in run.events}


def test_rejected_messages_are_counted_and_kept_out_of_the_delays(tmp_path: Path) -> None:
    result = talk(Fleet(), 2.0)
    bad = [
        result[40]._replace(key=POSITION.key("robot2"), payload=b"rubbish", arrived=result[40].arrived + 1e-4)
    ]
    bad += [
        result[41]._replace(key=CMD_VEL.key("robot2"), payload=b"rubbish", arrived=result[41].arrived + 1e-4)
    ]
    bad += [
        Fleet().position("robot3", START + 8.0)._replace(arrived=result[42].arrived + 1e-4)
    ]  # ahead of time
    record(tmp_path / "run.mcap", sorted([*result, *bad], key=lambda sample: sample.arrived))
    run = gathered(tmp_path / "run.mcap")
    keys = {key.key: key for key in run.keys}
    for key in (POSITION.key("robot2"), CMD_VEL.key("robot2"), POSITION.key("robot3")):
        assert keys[key].rejected == 1
    assert sum(run.snapshot.rejected.values()) == 3
    assert run.late["position"].count == sum(key.startswith("position", 7) for key, *_ in result)


def test_longest_silence_of_key_is_found_with_time(tmp_path: Path) -> None:
    result = [
        sample
        for sample in talk(Fleet(), 6.0)
        if sample.key != POSITION.key("robot3") or not START + 2.0 < sample.arrived < START + 2.8
    ]
    record(tmp_path / "run.mcap", result)
    key = next(key for key in gathered(tmp_path / "run.mcap").keys if key.key == POSITION.key("robot3"))
    assert key.gap == pytest.approx(0.83, abs=0.06)
    assert key.gap_at == pytest.approx(2.0, abs=0.1)
    assert key.missed == 16
    assert key.rate is not None
    assert key.rate < 20.0


def test_the_law_that_was_driven_is_the_law_of_the_run(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", talk(Fleet(), 1.0), read("six_robots")[0], law="paper")
    assert gathered(tmp_path / "run.mcap").mission.law.kind == "paper"
