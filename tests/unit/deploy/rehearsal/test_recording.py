"""Recordings of rehearsals: equal for equal seeds, complete, and verified by recomputation."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib.font_manager  # noqa: F401 - its first import on a machine lists fonts with a process
import pytest

from formation.deploy.recordings import report
from formation.deploy.refusal import Refusal
from formation.deploy.rehearsal import rehearsal
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.faults import KINDS, parse
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, rehearse, run
from formation.deploy.rehearse import main
from formation.mission.file import load, read
from formation.mission.file import parse as parse_mission
from formation.monitor.process import STOP_TIMEOUT_SECONDS
from formation.monitor.recording import reader
from formation.monitor.recording.part import Part
from formation.monitor.recording.recorder import Recorder
from formation.monitor.report import figures
from formation.wire import Outgoing, Sample
from tests.support.examples import slow
from tests.support.missions import row_of_three
from tests.support.recorded import verify
from tests.unit.deploy.commands import Capsys

PAIR = load("turtlebot3_pair")
MUTUAL = row_of_three(
    "mutual", rate=10, speed=0.1, neighbours=('["led", "b"]', '["led", "a"]', '["a"]'), behind=0.1
)
ALL = Plan(
    PAIR, tuple(KINDS), (parse("robot2:forge@3+4", PAIR),), Weather(loss=0.1),
    signed=True, text=read("turtlebot3_pair")[0],
)  # fmt: skip


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """End a rehearsal as soon as the formation has settled."""
    monkeypatch.setattr(rehearsal, "START_TIME", 3.0)


@pytest.mark.parametrize("seed", [11, *slow(0, 1, 2)])
def test_same_seed_gives_same_run_and_same_recording_bytes(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def published(plan: Plan) -> tuple[Verdict, list[tuple[float, Outgoing]]]:
        found: list[tuple[float, Outgoing]] = []

        class Watched(Fleet):
            def __init__(self, *arguments: Any, **options: Any) -> None:
                super().__init__(*arguments, **options)
                for exchange in (self.fleet, self.local):
                    exchange.watchers.append(lambda _, out: found.append((self.engine.now, out)))

        monkeypatch.setattr(rehearsal, "Fleet", Watched)
        return rehearse(plan, seed), found

    one, other = tmp_path / "one.mcap", tmp_path / "other.mcap"
    verdict, messages = published(ALL._replace(record=one))
    assert published(ALL._replace(record=other)) == (verdict, messages)
    assert one.read_bytes() == other.read_bytes()
    assert rehearse(ALL, seed) == verdict, "recording changes the run"


@pytest.mark.slow
def test_recorded_commands_recompute_exactly_with_wrong_clocks(tmp_path: Path) -> None:
    path = tmp_path / "clocks.mcap"
    mission = parse_mission(MUTUAL, "mutual")
    faults = [parse(text, mission) for text in ("a:clock=26.9@4+4", "b:drift@3+9")]
    assert run(Plan(mission, record=path, text=MUTUAL), 0, faults).violations == ()
    verdicts = verify(mission, ((one.sample, one.wall) for one in reader.read(path).messages()))
    assert all(one.compared > 100 and one.exact == one.compared for one in verdicts.values())


def write_without_later_odometry(
    recorder: Recorder, sample: Sample, wall: float, write: Any = Recorder.write
) -> None:
    if sample.key != "robot2/odom" or recorder.recorded["robot2/odom"] < 20:
        write(recorder, sample, wall)


def append_with_wrong_index(
    part: Part, record: bytes, chunk: Any, shift: int, *given: Any, append: Any = Part.append_packed
) -> None:
    append(part, record, chunk, 2 * shift + 1, *given)


@pytest.mark.parametrize(
    ("name", "instead", "what"),
    [
        ("monitor.recording.recorder.Recorder.write", write_without_later_odometry, "robot2/odom"),
        ("monitor.recording.part.Part.append_packed", append_with_wrong_index, ""),
        ("deploy.rehearsal.rules.recorded.EPOCH", 0.0, ""),
    ],
)
@pytest.mark.usefixtures("short")
def test_record_rule_detects_faulty_recording(
    name: str, instead: Any, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"formation.{name}", instead)
    verdict = run(Plan(PAIR, record=tmp_path / "run.mcap", text=ALL.text), 0, ())
    assert verdict.broken == {"record"}
    assert what in verdict.violations[0].what


@pytest.mark.parametrize("late", [0.0, 0.01, 0.02, 0.03, 0.04])
@pytest.mark.usefixtures("short")
def test_message_after_last_monitor_step_breaks_no_rule(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, late: float
) -> None:
    """As in `formation rehearse posts --seed 5`, where messages of robot6 came that late."""
    monkeypatch.setattr(rehearsal, "STOP_TIMEOUT_SECONDS", STOP_TIMEOUT_SECONDS + late)
    assert run(Plan(PAIR, record=tmp_path / "run.mcap"), 0, ()).violations == ()


@pytest.mark.usefixtures("short")
def test_report_accepts_recording_of_rehearsal(
    tmp_path: Path, capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(figures, "written", lambda *_: b"<svg></svg>")
    monkeypatch.setattr(report, "analyse", lambda _: None)  # would compile the law
    monkeypatch.setattr("formation.deploy.check.words", lambda *_: "")
    path = tmp_path / "run.mcap"
    flags = ["--faults", "none", "--record", str(path), "--noise", "0.001", "--json"]
    assert main(["turtlebot3_pair", *flags]) == 0
    assert json.loads(capsys.readouterr().out)["recording"] == str(path)
    assert "position_noise = 0.001" in reader.read(path).about["mission_file"]
    assert report.main([str(path)]) == 0
    assert path.with_suffix(".html").exists()


def test_record_flag_refuses_existing_file_and_several_seeds(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.touch()
    with pytest.raises(Refusal, match="exists already"):
        main(["turtlebot3_pair", "--record", str(path)])
    with pytest.raises(Refusal, match="records one run"):
        main(["turtlebot3_pair", "--record", str(tmp_path / "two.mcap"), "--seeds", "2"])
