"""`formation run` with small scripts in place of its processes: output, exit code and files."""

from __future__ import annotations

import os
import re
import shlex
import signal
import time
from itertools import islice
from pathlib import Path

import pytest

from formation.deploy.local import run
from formation.deploy.local.launch import STOP_TIMEOUTS
from formation.deploy.local.plan import programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from tests.processes.deploy.runner import FOUND, Runner, good_programs, monitor
from tests.processes.deploy.stubs import GOOD, READY, is_gone, program


@pytest.fixture
def runner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Runner:
    return Runner(tmp_path, monkeypatch, capsys)


def test_converged_run_exits_with_0_and_prints_json(runner: Runner, tmp_path: Path) -> None:
    begin = time.monotonic()
    done = runner(*good_programs())
    took = time.monotonic() - begin
    assert done.code == 0
    result = done.result
    processes = result.pop("processes")
    assert 0.3 <= result.pop("duration") <= took
    assert result == {
        "mission": "turtlebot3-pair",
        "law": "field",
        "robots": 3,
        "converged": True,
        "formation_error": 0.002,
        "known": None,
        "settling_time": 1.5,
        "interrupted": False,
        "recording": "a.mcap",
        "recorded": 37,
        "lost": 0,
    }
    assert [process["exit"] for process in processes.values()] == [0, 0, 0]
    assert all(is_gone(process["pid"]) for process in processes.values())
    assert processes["agent robot1"]["published"] == 20
    assert processes["robots"]["robot"] == {"published": 24, "received": 9}
    assert list(tmp_path.glob("formation-*")) == []  # logs are kept for failures


def test_run_without_json_prints_readable_summary(runner: Runner) -> None:
    done = runner(*good_programs(), flags=())
    assert done.code == 0
    assert "turtlebot3-pair, field law: converged" in done.out
    assert "2.0 mm" in done.out
    assert re.search(r"^  its figures +formation report .*a\.mcap$", done.out, re.MULTILINE)
    assert "{" not in done.out
    assert done.err == ""


def test_run_prints_page_address_before_table(runner: Runner) -> None:
    invitation = "http://127.0.0.1:8460/#token=secret"
    serves = monitor().replace("until_told(", f"until_told(page={invitation!r}, then=")
    done = runner(*good_programs(serves), flags=("--control",))
    assert done.code == 0
    lines = (line for line in done.out.splitlines() if line != run.OTHER_PORTS)
    hint, page, table = islice(lines, 3)
    assert hint.startswith("Ctrl-C ends it.")
    assert page == f"Page: {invitation}"
    assert table.startswith("turtlebot3-pair: starting")
    machine = runner(*good_programs(serves), record="b.mcap")
    assert f"Page: {invitation}\n" in machine.err
    assert "Page:" not in machine.out
    none = runner(*good_programs(), flags=("--no-page",), record="c.mcap")
    assert (none.code, "Page:" in none.out) == (0, False)


@pytest.mark.parametrize(
    ("flags", "passed"),
    [
        ((), []),
        (("--no-page",), ["--no-page"]),
        (("--control",), ["--control"]),
        (("--page", "8470", "--control"), ["--page", "127.0.0.1:8470", "--control"]),
    ],
)
def test_page_flags_are_passed_only_to_monitor(
    runner: Runner, flags: tuple[str, ...], passed: list[str]
) -> None:
    runner(*good_programs(), flags=("--json", *flags))
    assert runner.requested["page"] == passed
    mission = load("turtlebot3_pair")
    with Ports(mission) as ports:
        plan = programs(mission, "pair", ports.endpoints, parent=1, record=Path("a.mcap"), page=passed)
    argv = {one.name: list(one.argv) for one in plan}
    assert [word for word in argv.pop("monitor") if word in passed] == passed
    assert not [word for words in argv.values() for word in words if word in passed]


def test_control_without_page_and_bad_page_are_refused(runner: Runner) -> None:
    done = runner(*good_programs(), flags=("--no-page", "--control"))
    assert (done.code, done.out) == (2, "")
    assert "leave out --no-page" in done.err
    assert runner(*good_programs(), flags=("--page", "desk")).code == 2


def test_run_without_convergence_exits_with_1(runner: Runner) -> None:
    done = runner(*good_programs(monitor(converged=False, settling_time=None, settled_at=None)), flags=())
    assert done.code == 1
    assert "not converged" in done.out


def test_too_short_run_prints_rule_of_convergence(runner: Runner) -> None:
    done = runner(*good_programs(monitor(converged=False, settling_time=None, settled_at=4.5)), flags=())
    assert "field law: not converged" in done.out
    assert "since 4.5 s; converged means under it for at least 2 s" in done.out


def test_verdict_with_silent_robot_is_over_known_edges(runner: Runner) -> None:
    known = {"error": 0.012, "known_edges": 8, "edges": 11, "silent": {"robot4": 12.0}}
    known |= {"settled_at": 5.2, "converged": True}
    unknown = {"converged": False, "settling_time": None, "settled_at": None, "formation_error": None}
    done = runner(*good_programs(monitor(**unknown, known=known)), flags=())
    assert done.code == 1  # the whole formation has not converged
    over = "over 8 of 11 edges; 3 unknown (robot4 silent for 12 s)"
    assert f"field law: converged {over}" in done.out
    assert f"12 mm, sum {over}; under 50 mm since 5.2 s" in done.out.replace("5 cm", "50 mm")


def test_lost_counts_published_but_unrecorded_messages(runner: Runner) -> None:
    recorded = {"formation/error": 5, "robot1/cmd_vel": 8, "robot1/odom": 10, "robot1/ground_truth": 9}
    assert runner(*good_programs(monitor(recorded=recorded))).result["lost"] == 2 + 3


def test_failed_recording_exits_with_1(runner: Runner) -> None:
    done = runner(*good_programs(monitor(recording_failure="No space left on device")))
    assert done.code == 1
    assert "No space left on device" in done.err


def test_dead_process_is_named_and_run_continues(runner: Runner) -> None:
    code = f"{READY}; {runner.once_begun}; print('battery empty', file=sys.stderr); sys.exit(7)"
    done = runner(*good_programs(), program(code, "agent robot2", "control"), until_dead=["agent robot2"])
    assert done.code == 1
    assert done.result["converged"] is True
    assert done.result["duration"] >= 0.3
    assert done.result["processes"]["agent robot2"] == {
        "pid": done.result["processes"]["agent robot2"]["pid"],
        "exit": 7,
        "died": True,
        "published": None,
        "received": None,
        "dropped": None,
        "robot": {"published": None, "received": None},
    }
    assert "agent robot2 ended with exit code 7 during the run" in done.err
    assert "battery empty" in done.err


KILLED = "say('ready'); {}; os.kill(os.getpid(), signal.SIGKILL)"
LEADS = "until_told(); say('summary', published={'leader/position': 30, 'deputy/status': 4}); sys.exit(0)"


def test_killed_leader_with_standby_is_no_failure(runner: Runner) -> None:
    recorded = {**FOUND["recorded"], "leader/position": 50, "leader/status": 3, "deputy/status": 4}
    done = runner(
        *good_programs(monitor(recorded=recorded)),
        program(KILLED.format(runner.once_begun), "leader", "control"),
        program(LEADS, "standby deputy", "control"),
        until_dead=["leader"],
        mission="patrol",
    )
    assert done.code == 0
    assert "leader was killed (SIGKILL) during the run; another stood by to lead" in done.err
    assert done.result["processes"]["leader"]["died"] is True
    assert done.result["lost"] == 0  # the killed leader has reported no count of its messages


def test_ended_leader_with_standby_is_no_failure(runner: Runner) -> None:
    output = "say('summary', published={'leader/position': 20})"
    stopped = program(f"{READY}; {runner.once_begun}; {output}; sys.exit(0)", "leader", "control")
    recorded = {**FOUND["recorded"], "leader/position": 49, "deputy/status": 4}
    standby = program(LEADS, "standby deputy", "control")
    done = runner(
        *good_programs(monitor(recorded=recorded)), stopped, standby, until_dead=["leader"], mission="patrol"
    )
    assert done.code == 0
    assert "leader ended with exit code 0 during the run; another stood by to lead" in done.err
    assert done.result["lost"] == 1


def test_failing_leader_is_failure_despite_standby(runner: Runner) -> None:
    code = f"{READY}; {runner.once_begun}; sys.exit(1)"
    standby = program(LEADS, "standby deputy", "control")
    done = runner(
        *good_programs(), program(code, "leader", "control"), standby, until_dead=["leader"], mission="patrol"
    )
    assert done.code == 1
    assert "leader ended with exit code 1 during the run" in done.err


def test_killed_last_leader_is_a_failure(runner: Runner) -> None:
    names = ("leader", "standby deputy")
    leaders = [program(KILLED.format(runner.once_begun), name, "control") for name in names]
    assert runner(*good_programs(), *leaders, until_dead=names, mission="patrol").code == 1
    # a mission without standbys
    done = runner(*good_programs(), leaders[0], until_dead=["leader"], record="b.mcap")
    assert done.code == 1
    assert "leader was killed (SIGKILL) during the run\n" in done.err


def test_run_with_killed_monitor_reports_no_measurements(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    # a line each time, so that one follows the death, whenever that is
    monkeypatch.setattr("formation.deploy.terminal.views.LINE_PERIOD", 0.0)
    dies = program(KILLED.format(runner.once_begun), "monitor", "watch")
    done = runner(dies, *good_programs()[1:], until_dead=["monitor"])
    assert done.code == 1
    result = done.result
    assert (result["converged"], result["formation_error"], result["lost"]) == (False, None, None)
    assert "monitor was killed" in done.err
    assert "nothing is known: the monitor has ended" in done.err
    assert "recording  " not in done.err  # there is no recording


def test_run_names_cut_recording_of_killed_monitor(runner: Runner, tmp_path: Path) -> None:
    file = tmp_path / "recordings" / "cut.mcap"
    leaves = f"open({str(file)!r}, 'wb').close(); {KILLED.format(runner.once_begun)}"
    done = runner(
        program(leaves, "monitor", "watch"), *good_programs()[1:], until_dead=["monitor"], record=file.name
    )
    assert done.code == 1
    assert f"{file}, cut; formation report and replay read it" in done.err


def test_process_that_cannot_start_ends_run_before_begin(runner: Runner, tmp_path: Path) -> None:
    fails = program("print('agent: port taken', file=sys.stderr); sys.exit(1)", "agent robot2", "control")
    done = runner(*good_programs(), fails)
    assert (done.code, done.out) == (1, "")
    assert "agent robot2 ended with exit code 1" in done.err
    assert "agent: port taken" in done.err
    assert list(tmp_path.glob("formation-*/agent-robot2.log"))


def test_bad_input_found_by_process_exits_with_2(runner: Runner) -> None:
    fails = program("print('no such law', file=sys.stderr); sys.exit(2)", "agent robot2", "control")
    assert runner(*good_programs(), fails).code == 2


def test_process_not_ready_in_time_ends_run(runner: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "START_TIMEOUT_SECONDS", 0.5)
    monkeypatch.setattr("formation.deploy.local.launch.STOP_TIMEOUTS", {**STOP_TIMEOUTS, "control": 0.2})
    never = program("time.sleep(600)", "agent robot2", "control")
    done = runner(never, *good_programs())  # the first late process is named
    assert done.code == 1
    assert "agent robot2 was not ready within 0.5 s" in done.err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_first_signal_ends_run_with_summary(runner: Runner, number: signal.Signals) -> None:
    kick = f"{runner.once_begun}; os.kill({os.getpid()}, {number.value})"
    kicks = program(GOOD.replace("until_told()", f"until_told({kick!r})"), "killer", "body")
    done = runner(*good_programs(), kicks, duration=60.0)
    assert done.code == 0
    assert done.result["interrupted"] is True
    assert done.result["duration"] < 30.0
    assert all(process["exit"] == 0 for process in done.result["processes"].values())


def test_signal_before_ready_reports_no_killed_process(runner: Runner) -> None:
    kick = f"time.sleep(0.3); os.kill({os.getpid()}, {signal.SIGINT.value}); {GOOD}"
    done = runner(program("time.sleep(600)", "slow"), program(kick, "killer"))
    assert done.code == 1
    assert done.result["duration"] == 0.0
    assert done.result["processes"]["slow"]["exit"] == -signal.SIGTERM
    assert "had to be killed" not in done.err


def test_existing_recording_is_refused_and_not_overwritten(runner: Runner, tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "a.mcap").write_bytes(b"precious")
    done = runner(*good_programs())
    assert (done.code, done.out) == (2, "")
    assert "exists already" in done.err
    assert (tmp_path / "recordings" / "a.mcap").read_bytes() == b"precious"


def test_impossible_recording_folder_is_refused(runner: Runner, tmp_path: Path) -> None:
    (tmp_path / "recordings").write_text("a file, not a folder")
    done = runner(*good_programs())
    assert done.code == 2
    assert done.err.count("\n") == 1


def test_suggested_stop_command_quotes_mission_filename() -> None:
    with Ports(load("turtlebot3_pair")) as ports:
        words = shlex.split(run._how_to_order("my missions/it's.toml", ports).splitlines()[0])
    assert words[words.index("stop") + 1] == "my missions/it's.toml"


def test_run_on_other_ports_says_which_commands_need_them() -> None:
    with Ports(load("turtlebot3_pair")), Ports(load("turtlebot3_pair")) as second:
        hint, notice = run._how_to_order("turtlebot3_pair", second).splitlines()
    assert all(f"-e {end}" in hint for end in second.endpoints.agents.values())
    assert notice == run.OTHER_PORTS
