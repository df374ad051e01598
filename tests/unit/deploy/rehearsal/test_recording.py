"""A rehearsal's monitor and its recording: the same bytes for a seed, whole, and computed again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from formation.deploy.recordings import report
from formation.deploy.refusal import Refusal
from formation.deploy.rehearsal import rehearsal
from formation.deploy.rehearsal.faults import KINDS, parse
from formation.deploy.rehearsal.rehearsal import Plan, rehearse, run
from formation.deploy.rehearse import main
from formation.mission.file import load, read
from formation.mission.file import parse as parse_mission
from formation.monitor.process import STOP_TIMEOUT_SECONDS
from formation.monitor.recording import reader
from formation.monitor.recording.recorder import Recorder
from formation.wire import Sample
from tests.support.missions import row_of_three
from tests.support.recorded import verify
from tests.unit.deploy.commands import Capsys

PAIR = load("turtlebot3_pair")
MUTUAL = row_of_three(
    "mutual", rate=10, speed=0.1, neighbours=('["led", "b"]', '["led", "a"]', '["a"]'), behind=0.1
)
ALL = Plan(PAIR, tuple(KINDS), text=read("turtlebot3_pair")[0])


@pytest.mark.parametrize("seed", [0, *(pytest.param(one, marks=pytest.mark.slow) for one in (1, 2))])
def test_one_seed_gives_the_same_bytes(seed: int, tmp_path: Path) -> None:
    one, other = tmp_path / "one.mcap", tmp_path / "other.mcap"
    first = rehearse(ALL._replace(record=one), seed)
    assert rehearse(ALL._replace(record=other), seed) == first
    assert one.read_bytes() == other.read_bytes()
    assert rehearse(ALL._replace(monitored=True), seed) == first
    assert rehearse(ALL, seed) == first, "the monitor changes the run"


def test_recorded_agents_compute_the_same_with_wrong_clocks(tmp_path: Path) -> None:
    path = tmp_path / "clocks.mcap"
    mission = parse_mission(MUTUAL, "mutual")
    faults = [parse(text, mission) for text in ("a:clock=26.9@4+4", "b:drift@3+9")]
    assert run(Plan(mission, record=path, text=MUTUAL), 0, faults).violations == ()
    verdicts = verify(mission, ((one.sample, one.wall) for one in reader.read(path).messages()))
    assert all(one.compared > 100 and one.exact == one.compared for one in verdicts.values())


def test_message_that_is_not_recorded_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = Recorder.write

    def forgetful(self: Recorder, sample: Sample, wall: float) -> None:
        if sample.key != "robot2/odom" or self.recorded["robot2/odom"] < 20:
            write(self, sample, wall)

    monkeypatch.setattr(Recorder, "write", forgetful)
    verdict = run(Plan(PAIR, record=tmp_path / "less.mcap"), 0, ())
    assert verdict.broken == {"record"}
    assert "robot2/odom" in verdict.violations[0].what


@pytest.mark.parametrize("late", [0.0, 0.01, 0.02, 0.03, 0.04])
def test_message_after_the_last_step_of_the_monitor_is_not_missed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: float
) -> None:
    """As in `formation rehearse posts --seed 5`, where robot6's messages came then."""
    monkeypatch.setattr(rehearsal, "START_TIME", 3.0)
    monkeypatch.setattr(rehearsal, "STOP_TIMEOUT_SECONDS", STOP_TIMEOUT_SECONDS + late)
    assert run(Plan(PAIR, record=tmp_path / "run.mcap"), 0, ()).violations == ()


def test_report_reads_a_rehearsal(tmp_path: Path, capsys: Capsys) -> None:
    path = tmp_path / "run.mcap"
    assert (
        main(["turtlebot3_pair", "--faults", "none", "--record", str(path), "--noise", "0.001", "--json"])
        == 0
    )
    assert json.loads(capsys.readouterr().out)["recording"] == str(path)
    assert "position_noise = 0.001" in reader.read(path).about["mission_file"]
    assert report.main([str(path)]) == 0
    assert path.with_suffix(".html").exists()


def test_recording_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.touch()
    with pytest.raises(Refusal, match="exists already"):
        main(["turtlebot3_pair", "--record", str(path)])
    with pytest.raises(Refusal, match="records one run"):
        main(["turtlebot3_pair", "--record", str(tmp_path / "two.mcap"), "--seeds", "2"])
