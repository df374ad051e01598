"""`formation run` with small scripts in place of its processes: what it says, returns and leaves behind."""

from __future__ import annotations

import os
import re
import shlex
import signal
import time
from pathlib import Path

import pytest

from formation.deploy.local import run
from formation.deploy.local.launch import GRACE
from formation.deploy.local.plan import programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from tests.processes.deploy.runner import FOUND, Runner, good, monitor
from tests.processes.deploy.stubs import GOOD, READY, is_gone, program


@pytest.fixture
def ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Runner:
    return Runner(tmp_path, monkeypatch, capsys)


def test_converged_run_exits_with_0_and_json(ran: Runner, tmp_path: Path) -> None:
    begin = time.monotonic()
    done = ran(*good())
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


def test_without_json_the_summary_is_for_people(ran: Runner) -> None:
    done = ran(*good(), flags=())
    assert done.code == 0
    assert "turtlebot3-pair, field law: converged" in done.out
    assert "2.0 mm" in done.out
    assert re.search(r"^  its figures +formation report .*a\.mcap$", done.out, re.MULTILINE)
    assert "{" not in done.out
    assert done.err == ""


def test_where_the_page_is_stands_before_the_table(ran: Runner) -> None:
    invitation = "http://127.0.0.1:8460/#token=secret"
    serves = monitor().replace("until_told(", f"until_told(page={invitation!r}, then=")
    done = ran(*good(serves), flags=("--control",))
    assert done.code == 0
    hint, page, table = done.out.splitlines()[:3]
    assert hint.startswith("Ctrl-C ends it.")
    assert page == f"Page: {invitation}"
    assert table.startswith("turtlebot3-pair: starting")
    machine = ran(*good(serves), record="b.mcap")
    assert f"Page: {invitation}\n" in machine.err
    assert "Page:" not in machine.out


def test_a_monitor_without_a_page_holds_up_nothing(ran: Runner) -> None:
    done = ran(*good(), flags=("--no-page",))
    assert done.code == 0
    assert "Page:" not in done.out


@pytest.mark.parametrize(
    ("flags", "passed"),
    [
        ((), []),
        (("--no-page",), ["--no-page"]),
        (("--control",), ["--control"]),
        (("--page", "8470", "--control"), ["--page", "127.0.0.1:8470", "--control"]),
    ],
)
def test_page_flags_are_passed_to_the_monitor_only(
    ran: Runner, flags: tuple[str, ...], passed: list[str]
) -> None:
    ran(*good(), flags=("--json", *flags))
    assert ran.requested["page"] == passed
    mission = load("turtlebot3_pair")
    with Ports(mission) as ports:
        plan = programs(mission, "pair", ports.endpoints, parent=1, record=Path("a.mcap"), page=passed)
    argv = {one.name: list(one.argv) for one in plan}
    assert [word for word in argv.pop("monitor") if word in passed] == passed
    assert not [word for words in argv.values() for word in words if word in passed]


def test_orders_by_a_page_that_is_not_served_are_refused(ran: Runner) -> None:
    done = ran(*good(), flags=("--no-page", "--control"))
    assert (done.code, done.out) == (2, "")
    assert "--no-page leaves out" in done.err
    assert ran(*good(), flags=("--page", "desk")).code == 2


def test_a_run_that_did_not_converge_is_exit_code_1(ran: Runner) -> None:
    done = ran(*good(monitor(converged=False, settling_time=None, settled_at=None)), flags=())
    assert done.code == 1
    assert "not converged" in done.out


def test_a_run_too_short_to_converge_says_the_rule(ran: Runner) -> None:
    done = ran(*good(monitor(converged=False, settling_time=None, settled_at=4.5)), flags=())
    assert "field law: not converged" in done.out
    assert "since 4.5 s; converged means under it for at least 2 s" in done.out


def test_survivors_verdict_is_over_the_known_edges(ran: Runner) -> None:
    known = {"error": 0.012, "known_edges": 8, "edges": 11, "silent": {"robot4": 12.0}}
    known |= {"settled_at": 5.2, "converged": True}
    unknown = {"converged": False, "settling_time": None, "settled_at": None, "formation_error": None}
    done = ran(*good(monitor(**unknown, known=known)), flags=())
    assert done.code == 1  # the whole formation has not converged
    over = "over 8 of 11 edges; 3 unknown (robot4 silent for 12 s)"
    assert f"field law: converged {over}" in done.out
    assert f"12 mm, sum {over}; under 50 mm since 5.2 s" in done.out.replace("5 cm", "50 mm")


def test_what_was_published_and_not_recorded_is_lost(ran: Runner) -> None:
    recorded = {"formation/error": 5, "robot1/cmd_vel": 8, "robot1/odom": 10, "robot1/ground_truth": 9}
    assert ran(*good(monitor(recorded=recorded))).result["lost"] == 2 + 3


def test_a_recording_that_failed_on_the_way_is_exit_code_1(ran: Runner) -> None:
    done = ran(*good(monitor(recording_failure="No space left on device")))
    assert done.code == 1
    assert "No space left on device" in done.err


def test_dead_process_is_named_and_run_continues(ran: Runner) -> None:
    code = f"{READY}; {ran.once_begun}; print('battery empty', file=sys.stderr); sys.exit(7)"
    done = ran(*good(), program(code, "agent robot2", "control"), until_dead=["agent robot2"])
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


def test_killed_leader_with_standby_is_no_failure(ran: Runner) -> None:
    recorded = {**FOUND["recorded"], "leader/position": 50, "leader/status": 3, "deputy/status": 4}
    done = ran(
        *good(monitor(recorded=recorded)),
        program(KILLED.format(ran.once_begun), "leader", "control"),
        program(LEADS, "standby deputy", "control"),
        until_dead=["leader"],
        mission="patrol",
    )
    assert done.code == 0
    assert "leader was killed (SIGKILL) during the run; another stood by to lead" in done.err
    assert done.result["processes"]["leader"]["died"] is True
    assert done.result["lost"] == 0  # how often the dead one said where it was, it did not live to tell


def test_stopped_leader_with_standby_is_no_failure(ran: Runner) -> None:
    output = "say('summary', published={'leader/position': 20})"
    stopped = program(f"{READY}; {ran.once_begun}; {output}; sys.exit(0)", "leader", "control")
    recorded = {**FOUND["recorded"], "leader/position": 49, "deputy/status": 4}
    standby = program(LEADS, "standby deputy", "control")
    done = ran(*good(monitor(recorded=recorded)), stopped, standby, until_dead=["leader"], mission="patrol")
    assert done.code == 0
    assert "leader ended with exit code 0 during the run; another stood by to lead" in done.err
    assert done.result["lost"] == 1


def test_failing_leader_is_failure_despite_standby(ran: Runner) -> None:
    code = f"{READY}; {ran.once_begun}; sys.exit(1)"
    standby = program(LEADS, "standby deputy", "control")
    done = ran(*good(), program(code, "leader", "control"), standby, until_dead=["leader"], mission="patrol")
    assert done.code == 1
    assert "leader ended with exit code 1 during the run" in done.err


def test_killed_last_leader_is_a_failure(ran: Runner) -> None:
    names = ("leader", "standby deputy")
    leaders = [program(KILLED.format(ran.once_begun), name, "control") for name in names]
    assert ran(*good(), *leaders, until_dead=names, mission="patrol").code == 1
    done = ran(*good(), leaders[0], until_dead=["leader"], record="b.mcap")  # a mission without standbys
    assert done.code == 1
    assert "leader was killed (SIGKILL) during the run\n" in done.err


def test_without_the_monitors_last_word_nothing_is_claimed(ran: Runner) -> None:
    dies = program(KILLED.format(ran.once_begun), "monitor", "watch")
    done = ran(dies, *good()[1:], duration=3.0, until_dead=["monitor"])  # there is a line every 2 s
    assert done.code == 1
    result = done.result
    assert (result["converged"], result["formation_error"], result["lost"]) == (False, None, None)
    assert "monitor was killed" in done.err
    assert "there are no measurements any more" in done.err
    assert "recording  " not in done.err  # for there is none


def test_what_a_monitor_that_was_killed_has_recorded_is_named(ran: Runner, tmp_path: Path) -> None:
    file = tmp_path / "recordings" / "cut.mcap"
    leaves = f"open({str(file)!r}, 'wb').close(); {KILLED.format(ran.once_begun)}"
    done = ran(program(leaves, "monitor", "watch"), *good()[1:], until_dead=["monitor"], record=file.name)
    assert done.code == 1
    assert f"{file}, cut; formation report and replay read it" in done.err


def test_a_process_that_cannot_start_ends_the_run_before_it_begins(ran: Runner, tmp_path: Path) -> None:
    fails = program("print('agent: port taken', file=sys.stderr); sys.exit(1)", "agent robot2", "control")
    done = ran(*good(), fails)
    assert (done.code, done.out) == (1, "")
    assert "agent robot2 ended with exit code 1" in done.err
    assert "agent: port taken" in done.err
    assert list(tmp_path.glob("formation-*/agent-robot2.log"))


def test_bad_input_found_by_process_exits_with_2(ran: Runner) -> None:
    fails = program("print('no such law', file=sys.stderr); sys.exit(2)", "agent robot2", "control")
    assert ran(*good(), fails).code == 2


def test_a_process_that_never_gets_ready_ends_the_run(ran: Runner, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "START_TIMEOUT_SECONDS", 0.5)
    monkeypatch.setattr("formation.deploy.local.launch.GRACE", {**GRACE, "control": 0.2})
    never = program("time.sleep(600)", "agent robot2", "control")
    done = ran(never, *good())  # of those that are late the first is named
    assert done.code == 1
    assert "agent robot2 was not ready within 0.5 s" in done.err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_signal_ends_the_run_with_its_summary(ran: Runner, number: signal.Signals) -> None:
    kick = f"{ran.once_begun}; os.kill({os.getpid()}, {number.value})"
    kicks = program(GOOD.replace("until_told()", f"until_told({kick!r})"), "somebody", "body")
    done = ran(*good(), kicks, duration=60.0)
    assert done.code == 0
    assert done.result["interrupted"] is True
    assert done.result["duration"] < 30.0
    assert all(process["exit"] == 0 for process in done.result["processes"].values())


def test_early_signal_does_not_blame_processes_not_ready(ran: Runner) -> None:
    kick = f"time.sleep(0.3); os.kill({os.getpid()}, {signal.SIGINT.value}); {GOOD}"
    done = ran(program("time.sleep(600)", "slow"), program(kick, "somebody"))
    assert done.code == 1
    assert done.result["duration"] == 0.0
    assert done.result["processes"]["slow"]["exit"] == -signal.SIGTERM
    assert "had to be killed" not in done.err


def test_a_recording_that_exists_is_not_overwritten_and_nothing_starts(ran: Runner, tmp_path: Path) -> None:
    (tmp_path / "recordings").mkdir()
    (tmp_path / "recordings" / "a.mcap").write_bytes(b"precious")
    done = ran(*good())
    assert (done.code, done.out) == (2, "")
    assert "exists already" in done.err
    assert (tmp_path / "recordings" / "a.mcap").read_bytes() == b"precious"


def test_a_folder_that_cannot_be_made_is_refused(ran: Runner, tmp_path: Path) -> None:
    (tmp_path / "recordings").write_text("a file, not a folder")
    done = ran(*good())
    assert done.code == 2
    assert done.err.count("\n") == 1


def test_a_recording_s_name_that_no_disk_takes_is_refused(ran: Runner) -> None:
    done = ran(*good(), record=f"{'long' * 75}.mcap")
    assert (done.code, done.out) == (2, "")
    assert done.err.endswith("long.mcap: File name too long\n")
    assert done.err.count("\n") == 1


def test_suggested_order_can_be_pasted_for_any_filename() -> None:
    with Ports(load("turtlebot3_pair")) as ports:
        words = shlex.split(run._how_to_order("my missions/it's.toml", ports))
    assert words[words.index("stop") + 1] == "my missions/it's.toml"
