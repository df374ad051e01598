"""`formation replay FILE --verify`: output and exit codes."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from formation.agent.verify.core import Verdict
from formation.deploy.recordings import replay, verify
from formation.deploy.refusal import Refusal
from formation.mission.file import load, read
from formation.monitor.metrics.keys import watched
from formation.monitor.recording.reader import read as read_recording
from formation.monitor.recording.recorder import Recorder
from formation.topics import CMD_VEL, POSITION
from tests.support.recorded import RecordedFleet, Recording
from tests.unit.deploy.commands import Capsys

TEXT = read("turtlebot3_pair")[0]
PAIR = load("turtlebot3_pair")


@cache
def recorded_run(law: str | None = None) -> Recording:
    fleet = RecordedFleet(PAIR, law=law)
    fleet.run(8.0)
    return fleet.record


def written(path: Path, record: Recording, text: str = TEXT, law: str = "field") -> Path:
    with Recorder(path, PAIR.name, text, law, watched(PAIR)) as recorder:
        for sample, wall in record:
            recorder.write(sample, wall)
    return path


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("run") / "run.mcap", recorded_run())


def with_gain(folder: Path, old: str = "[law]", new: str = "[law]\ngain = 2.1") -> Path:
    assert old in TEXT
    path = folder / "changed.toml"
    path.write_text(TEXT.replace(old, new))
    return path


def verified(capsys: Capsys, path: Path, *flags: str) -> tuple[int, str, dict[str, Any]]:
    """Exit code, text and JSON of a verification."""
    code = verify.main([str(path), "--verify", "--json", *flags])
    out, words = capsys.readouterr()
    return code, words, json.loads(out)


def run_without(name: str, since: float, until: float) -> Recording:
    """The run without the messages on `name` received between `since` and `until` [s]."""
    start = recorded_run()[0][1]
    return [
        (one, wall) for one, wall in recorded_run() if one.key != name or not since < wall - start < until
    ]


def test_recording_of_same_code_verifies_exactly(file: Path, capsys: Capsys) -> None:
    assert replay.main([str(file), "--verify"]) == 0
    capsys.readouterr()
    code, text, result = verified(capsys, file)
    assert code == 0
    assert text.count("equal to the last bit") == 2
    assert f"no difference in {result['compared']} commands" in text
    commands = sum(sample.key.endswith(CMD_VEL.name) for sample, _ in recorded_run())
    assert result["compared"] == result["exact"] == commands
    assert (result["differing"], result["first"], result["notes"]) == (0, None, [])
    assert [one["not_judged"] for one in result["robots"].values()] == [[], []]


def test_verification_slower_than_the_run_states_its_pace(file: Path) -> None:
    ran = verify.run(read_recording(file), None, None, 1e-9)._replace(length=8.0, took=16.0)
    assert list(verify.words(ran))[-1].endswith("; took 16.0 s, 0.5 times as fast as the run")


def test_other_gain_reports_first_differing_command(file: Path, tmp_path: Path, capsys: Capsys) -> None:
    code, text, result = verified(capsys, file, "--mission", str(with_gain(tmp_path)))
    assert code == 1
    first = result["first"]
    assert f"the first command that differs is {first['robot']}'s at {first['at']:.3f} s" in text
    assert f"recorded u {first['recorded']['speed']:+.9f} m/s" in text
    assert f"computed u {first['computed']['speed']:+.9f} m/s" in text
    assert f"{first['robot']}/odom" in text
    assert first == {"robot": first["robot"], **result["robots"][first["robot"]]["first"]}
    assert result["differing"] == sum(one["differing"] for one in result["robots"].values()) > 10


def test_differences_within_tolerance_pass(file: Path, tmp_path: Path, capsys: Capsys) -> None:
    mission = with_gain(tmp_path, "[law]", "[law]\ngain = 2.501")
    arguments = [str(file), "--verify", "--mission", str(mission)]
    assert verify.main([*arguments, "--tolerance", "0"]) == 1
    assert verify.main([*arguments, "--tolerance", "2"]) == 0
    assert capsys.readouterr().out.count("the rest off by") == 2


def test_law_flag_overrides_recorded_law(tmp_path: Path, capsys: Capsys) -> None:
    path = written(tmp_path / "paper.mcap", recorded_run("paper"), law="paper")
    assert verify.main([str(path), "--verify"]) == 0
    assert "note" not in capsys.readouterr().out
    assert verify.main([str(path), "--verify", "--law", "field"]) == 1


def test_unjudged_commands_are_reported_with_reason(tmp_path: Path, capsys: Capsys) -> None:
    path = written(tmp_path / "lossy.mcap", run_without(POSITION.key("leader"), 1.0, 1.1))
    code, text, result = verified(capsys, path, "--min-compared", "0.3")
    assert code == 0
    (stretch,) = result["robots"]["robot1"]["not_judged"]
    why = "a message on leader/position that its agent received is missing in the recording"
    assert stretch["reason"] == why
    assert f"not judged: {stretch['commands']} commands, 1." in text


def test_cut_recording_is_verified_to_its_end(file: Path, tmp_path: Path, capsys: Capsys) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(file.read_bytes()[: file.stat().st_size * 2 // 3])
    code, text, result = verified(capsys, path)
    assert "note: the recording is cut" in text
    enough = result["least_share"] >= verify.MIN_COMPARED_SHARE
    assert code == (2 if not result["compared"] else 0 if enough else verify.EXIT_TOO_FEW)


def test_damaged_recording_gives_no_verdict_and_says_why(file: Path, tmp_path: Path, capsys: Capsys) -> None:
    path, data = tmp_path / "damaged.mcap", bytearray(file.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 400] = bytes(400)
    path.write_bytes(data)
    code, text, result = verified(capsys, path)
    assert code in {2, verify.EXIT_TOO_FEW}
    assert result["least_share"] < verify.MIN_COMPARED_SHARE
    assert "note: the recording is damaged in one place" in text


def test_too_few_compared_commands_give_no_verdict(tmp_path: Path, capsys: Capsys) -> None:
    key, begin = CMD_VEL.key("robot1"), recorded_run()[0][1]
    later = [i for i, (sample, wall) in enumerate(recorded_run()) if sample.key == key and wall > begin + 2.0]
    lost = set(later[: len(later) // 2])
    record = [
        (sample._replace(attachment=None) if i in lost else sample, wall)
        for i, (sample, wall) in enumerate(recorded_run())
    ]
    path = written(tmp_path / "few.mcap", record)
    code, text, result = verified(capsys, path)
    assert code == verify.EXIT_TOO_FEW
    assert f"only {result['least_share']:.1%} of robot1's commands were compared" in text
    assert "at least 99.0% are needed (--min-compared)" in text
    assert result["robots"]["robot2"]["share"] == 1.0
    assert verified(capsys, path, "--min-compared", f"{result['least_share']:.3f}")[0] == 0


def test_uncompared_robot_gives_no_verdict(tmp_path: Path) -> None:
    key = CMD_VEL.key("robot1")
    record = [
        (one._replace(attachment=None) if one.key == key else one, wall) for one, wall in recorded_run()
    ]
    assert verify.main([str(written(tmp_path / "one.mcap", record)), "--verify"]) == verify.EXIT_TOO_FEW


def test_robot_without_commands_gives_no_verdict(tmp_path: Path, capsys: Capsys) -> None:
    path = written(tmp_path / "silent.mcap", run_without(CMD_VEL.key("robot1"), -1.0, math.inf))
    assert verify.main([str(path), "--verify"]) == verify.EXIT_TOO_FEW
    assert "no verdict: no command of robot1 in the recording" in capsys.readouterr().out
    assert verify.main([str(path), "--verify", "--min-compared", "0"]) == 0


def test_lost_commands_lower_the_share(tmp_path: Path, capsys: Capsys) -> None:
    path = written(tmp_path / "gap.mcap", run_without(CMD_VEL.key("robot1"), 2.0, 4.0))
    code, _, result = verified(capsys, path)
    assert code == verify.EXIT_TOO_FEW
    robot = result["robots"]["robot1"]
    assert robot["lost"] == pytest.approx(40, abs=2)
    assert robot["share"] < robot["compared"] / robot["commands"]


def test_commands_before_first_traced_state_do_not_count(tmp_path: Path, capsys: Capsys) -> None:
    begin = recorded_run()[0][1]
    late = [(sample, wall) for sample, wall in recorded_run() if wall > begin + 1.0]
    code, text, result = verified(capsys, written(tmp_path / "late.mcap", late))
    assert code == 0
    for one in result["robots"].values():
        assert one["lead_in"] == one["commands"] - one["compared"] > 10
        assert one["share"] == 1.0
    assert "before the first state in its trace do not count" in text


def test_agents_that_drove_by_another_mission_are_named(tmp_path: Path, capsys: Capsys) -> None:
    path = written(tmp_path / "other.mcap", recorded_run(), TEXT.replace("[law]", "[law]\ngain = 2.1"))
    assert verify.main([str(path), "--verify"]) == 1
    assert "agents of robot1, robot2 drove by another mission" in capsys.readouterr().out


def test_rehearsal_under_another_law_is_of_its_mission(tmp_path: Path, capsys: Capsys) -> None:
    fleet = RecordedFleet(PAIR.under("paper"))
    fleet.run(2.0)
    path = written(tmp_path / "rehearsed.mcap", fleet.record, law="paper")
    assert verified(capsys, path)[2]["notes"] == []


def test_recording_without_traces_exits_with_2(tmp_path: Path, capsys: Capsys) -> None:
    record = [(sample._replace(attachment=None), wall) for sample, wall in recorded_run()]
    path = written(tmp_path / "old.mcap", record)
    assert verify.main([str(path), "--verify"]) == 2
    text = capsys.readouterr().out
    assert text.count("no trace of it in the recording") == 2
    assert "nothing could be compared" in text


def test_empty_recording_exits_with_2(tmp_path: Path, capsys: Capsys) -> None:
    assert verify.main([str(written(tmp_path / "empty.mcap", [])), "--verify"]) == 2
    assert capsys.readouterr().out.count("no command in the recording") == 2


@pytest.mark.parametrize(
    ("file", "flags", "why"),
    [
        ("none.mcap", (), "cannot be read"),
        ("bad.toml", (), "is no recording"),
        (".", (), "cannot be"),
        ("run.mcap", ("--mission", "bad.toml"), r"bad\.toml"),
    ],
)
def test_unreadable_recording_or_mission_is_refused(
    file: str, flags: Sequence[str], why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_bytes(b"rubbish" * 1000)
    written(Path("run.mcap"), recorded_run()[:100])
    with pytest.raises(Refusal, match=why):
        verify.main([file, "--verify", *flags])


def test_verify_with_wrong_mission_names_unknown_robots(file: Path, capsys: Capsys) -> None:
    assert verify.main([str(file), "--verify", "--mission", "two_chains"]) == 2
    text = capsys.readouterr().out
    assert "no such follower: robot1, robot2" in text
    assert "the recording is of mission turtlebot3-pair, not of two-chains" in text


def test_missing_command_reports_difference_without_distance() -> None:
    silent = Verdict("robot2", commands=139, compared=139, differing=139, most_off=(math.inf, math.inf))
    assert verify._verdict(silent) == "139 of 139 commands compared, 139 DIFFER"
