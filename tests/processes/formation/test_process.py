from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from types import SimpleNamespace

import pytest

from formation.mission.file import MissionError, load
from formation.ros2.messages import TwistStamped, decode, encode
from formation.topics import STATUS
from formation.transport.bus import Bus, BusConfig, BusError
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from formation.transport.runtime import clock, process
from formation.transport.runtime.clock import monotonic
from formation.transport.runtime.flags import bus_config, parser
from formation.transport.runtime.process import BadInput, Process, Stop, one_of, run_process, say
from formation.transport.runtime.rate import Rate
from formation.transport.wiring import Links
from formation.wire import Now, Outgoing, Sample
from tests.support.child import free_endpoint

IMPLIED = Links(("tcp/127.0.0.1:7460",), ("tcp/127.0.0.1:7461",))


class Counting:
    """A core that steps every 10 ms and calls `then` after `steps` of them."""

    publications = ((STATUS, "robot2/status"),)
    subscriptions = ("robot1/position",)

    def __init__(self, steps: int, then: Callable[[], object]) -> None:
        self.dropped = {"robot1/position": 3}
        self.halted: list[str] = []
        self._rate = Rate(100.0)
        self._steps, self._then = steps, then

    @property
    def due(self) -> float:
        return self._rate.due

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        assert not inbox
        if self._rate.tick(now.mono) and self._rate.ticks == self._steps:
            self._then()
        return [Outgoing("robot2/status", b"step")]

    def halt(self, now: Now, reason: str) -> list[Outgoing]:
        assert now.mono >= self.due - 0.02
        self.halted.append(reason)
        return [Outgoing("robot2/status", b"last words")]


def run(core: Counting) -> int:
    def main(stop: Stop) -> None:
        with Process("agent robot2", flags(), BusConfig(), stop) as one:
            one.declare(core)
            one.ready("robot2/status")
            one.play(one.loop(core))

    return run_process("robot2", flags(), main)


def test_core_steps_until_signal_and_then_halts(
    capsys: pytest.CaptureFixture[str],
) -> None:
    started = time.monotonic()
    core = Counting(20, lambda: signal.raise_signal(signal.SIGINT))
    assert run(core) == 0
    assert core.halted == ["SIGINT"]
    assert time.monotonic() - started >= 0.19
    ready, summary = map(json.loads, capsys.readouterr().out.splitlines())
    assert ready == {"event": "ready", "process": "agent robot2"}
    assert summary["published"]["robot2/status"] >= 21
    assert summary["dropped"] == {"robot1/position": 3, "overflowed": 0}
    assert summary["robot"] == {"published": {}, "received": {}}
    assert summary["refused"] == {}


def test_failing_core_is_halted_and_exits_with_1(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    core = Counting(5, lambda: 1 // 0)
    assert run(core) == 1
    assert core.halted == ["failed"]
    assert "ZeroDivisionError" in caplog.text
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["published"]["robot2/status"] >= 5


def flags(*arguments: str) -> argparse.Namespace:
    return parser("thing", "Do the thing.", "  formation thing six_robots").parse_args(
        ["six_robots", *arguments]
    )


def test_process_without_bus_raises_bus_error() -> None:
    with Stop() as stop, Process("watchdog robot2", flags(), None, stop) as one:
        with pytest.raises(BusError, match="watchdog robot2 is not on the fleet's bus"):
            one.bus.publish("robot2/status", b"")
        with pytest.raises(BusError, match="watchdog robot2 is not on a robot's bus"):
            one.robot.close()


def test_failing_robot_bus_leaves_fleet_port_free() -> None:
    def robot(mailbox: Mailbox) -> RobotBus:
        raise BusError(f"{mailbox.overflowed} robots")

    config = BusConfig(listen=(free_endpoint(),))
    with Stop() as stop, pytest.raises(BusError, match="0 robots"):
        Process("agent robot2", flags(), config, stop, robot)
    with Bus(config):
        pass


def test_signal_requests_stop_and_ends_sleep() -> None:
    woken = []
    with Stop() as stop:
        stop.wakes(lambda: woken.append(1))
        assert not stop
        signal.raise_signal(signal.SIGTERM)
        assert stop
    assert stop.reason == "SIGTERM"
    assert woken == [1]


@pytest.mark.usefixtures("in_a_terminal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_ending_signals_are_handled_and_restored(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with Stop() as stop:
        signal.raise_signal(number)
        signal.raise_signal(number)  # twice: the terminal and the supervisor both send it
        assert stop.reason == number.name
    assert signal.getsignal(number) is before


def test_process_started_by_nohup_ignores_sighup() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Stop() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert not stop
    finally:
        signal.signal(signal.SIGHUP, before)


def test_second_signal_after_grace_time_ends_hanging_process() -> None:
    hangs = (
        "import signal, time; from formation.transport.runtime import process\n"
        "process.GRACE_TIME = 0.0\n"
        "with process.Stop() as stop:\n"
        "    signal.raise_signal(signal.SIGTERM); time.sleep(0.01); print('polite', flush=True)\n"
        "    signal.raise_signal(signal.SIGTERM); print('never')\n"
    )
    ended = subprocess.run([sys.executable, "-c", hangs], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (128 + signal.SIGTERM, "polite\n")


def test_process_with_a_new_parent_stops() -> None:
    assert not Stop(parent=os.getppid())
    orphan = Stop(parent=os.getpid())
    assert orphan
    assert str(os.getpid()) in orphan.reason


@pytest.mark.parametrize("error", [MissionError, BusError, BadInput])
def test_bad_input_prints_one_line_on_stderr_and_exits_2(
    error: type[Exception], capsys: pytest.CaptureFixture[str]
) -> None:
    def main(_stop: Stop) -> None:
        raise error("the wheel is square; it must be round")

    assert run_process("robot2", flags(), main) == 2
    result = capsys.readouterr()
    assert (result.out, result.err) == ("", "robot2: the wheel is square; it must be round\n")


def test_other_failure_is_logged_and_exits_1(caplog: pytest.LogCaptureFixture) -> None:
    def main(_stop: Stop) -> None:
        raise ZeroDivisionError("somewhere deep")

    assert run_process("robot2", flags(), main) == 1
    assert "somewhere deep" in caplog.text


@pytest.mark.parametrize(("result", "code"), [(None, 0), (True, 0), (False, 1)])
def test_process_exits_1_if_its_main_function_failed(result: bool | None, code: int) -> None:
    assert run_process("robot2", flags(), lambda _stop: result) == code


def test_say_prints_one_json_object_per_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("ready", process="agent robot2")
    say("summary", published={"a/b": 1})
    first, second = map(json.loads, capsys.readouterr().out.splitlines())
    assert first == {"event": "ready", "process": "agent robot2"}
    assert second == {"event": "summary", "published": {"a/b": 1}}


def test_say_survives_closed_reader_of_stdout() -> None:
    talks = """
from formation.transport.runtime.process import say
for i in range(20000):
    say('ready', process='x' * 50)
"""
    with subprocess.Popen(
        [sys.executable, "-c", talks], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        assert child.stderr is not None
        child.stdout.close()
        errors = child.stderr.read()
    assert (child.returncode, errors) == (0, b"")


def test_invalid_choice_error_names_valid_choices() -> None:
    assert one_of("--robot", "robot2", ("robot2", "robot3")) == "robot2"
    with pytest.raises(BadInput, match=r"--robot 'robot9': must be one of robot2, robot3"):
        one_of("--robot", "robot9", ("robot2", "robot3"))


def test_bus_config_without_flags_has_links_of_mission() -> None:
    config = bus_config(flags(), load("six_robots"), IMPLIED, "thing")
    assert (config.listen, config.connect, config.implied) == ((), (), IMPLIED)
    assert (config.mode, config.namespace, config.name) == (None, "", "thing")


def test_link_flags_replace_all_links_of_mission() -> None:
    config = bus_config(
        flags("-e", "tcp/10.0.0.1:7447", "-e", "tls/b:1"), load("six_robots"), IMPLIED, "thing"
    )
    assert (config.listen, config.connect) == ((), ("tcp/10.0.0.1:7447", "tls/b:1"))
    assert config.implied is None


def test_bus_config_passes_zenoh_settings_and_team_as_namespace() -> None:
    mission = load("six_robots").model_copy(update={"team": "red"})
    args = flags("-m", "client", "--cfg", "transport/link/tx/lease:2000", "--no-multicast-scouting")
    config = bus_config(args, mission, IMPLIED, "thing")
    assert (config.mode, config.namespace) == ("client", "red")
    assert config.overrides == (("transport/link/tx/lease", "2000"),)


@pytest.mark.parametrize(
    "wrong",
    [["--await-monitor", "-1"], ["--await-monitor", "nan"], ["--await-monitor", "soon"], ["-m", "boss"]],
)
def test_invalid_flag_value_is_refused(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as refused:
        flags(*wrong)
    assert refused.value.code == 2
    assert wrong[0] in capsys.readouterr().err


def test_help_shows_the_examples(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        flags("--help")
    assert "examples:\n  formation thing six_robots" in capsys.readouterr().out


@pytest.mark.parametrize("set_to", [-1e9, 4e9])
def test_invalid_system_clock_still_gives_valid_stamps(
    set_to: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(time, "time", lambda: set_to)
    now = process.clocks()
    assert decode(TwistStamped, encode(TwistStamped(now.wall, 0.0, 0.0))).stamp == now.wall


def test_pause_between_clock_readings_does_not_change_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    now, pauses = 0.0, iter([0.5])

    def since_boot() -> float:
        nonlocal now
        now += next(pauses, 0.0)
        return now + 100.0

    monkeypatch.setattr(clock, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(clock, "_since_boot", since_boot)
    assert clock._offset() == 100.0


def test_clocks_reads_monotonic_and_system_time() -> None:
    before = monotonic(), time.time()
    now = process.clocks()
    assert before[0] <= now.mono <= monotonic()
    assert before[1] <= now.wall <= time.time()
