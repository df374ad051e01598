"""A guard beside a simulated robot, whose agent is played here: whom it stops, and whom it leaves alone.

How often it says zero is counted on a simulated clock (`tests/agent/test_guard.py`); here, that it arrives.
"""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from agent.robots.guard.core import BRAKING, PARKING, SLOW
from formation.transport.bus import Bus, BusConfig
from tests.processes.bus_tools import until
from tests.processes.child import Child, free_endpoint, started
from tests.processes.guard_scene import COMMAND, LIFE, PARKED, SPEED, Scene, gaps
from tests.processes.guarded import NICE, PERIOD
from tests.processes.relay import Relay

pytestmark = pytest.mark.processes


TWIST = ("ros2dds", "twist")
both = pytest.mark.parametrize(
    "scene", [TWIST, ("rmw_zenoh", "twist_stamped")], ids=lambda wire: wire[0], indirect=True
)
"""Both spellings, each with another type of command."""


@pytest.fixture
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(stack, tmp_path, *getattr(request, "param", TWIST))


def ended(child: Child) -> str:
    """End a guard; its log."""
    child.signal(signal.SIGTERM)
    published = child.event("summary")["robot"]["published"]
    assert child.wait() == 0
    assert set(published) <= {COMMAND}
    return child.errors


def parked(guard: Child, times: int = 1) -> None:
    """Wait until a guard has parked its robot so often."""
    until(lambda: guard.log.count(PARKED) == times)


def said_for_half_a_second(scene: Scene, zeros: list[float]) -> bool:
    """Whether zero was said for so long to park a robot, but for times when this machine stood still."""
    start, end = zeros[0], zeros[-1]
    stood_still = end + PERIOD - start - scene.ran(start, end + PERIOD)
    return abs(end + PERIOD - start - PARKING) <= PERIOD + stood_still


@both
def test_a_robot_whose_agent_fell_silent_stands_whatever_comes_late_until_the_agent_took_its_leave(
    scene: Scene,
) -> None:
    scene.robot()
    scene.listen()
    guard = scene.guard()
    assert {one.speed for one in scene.drive(1.0, alive=True)} == {SPEED}
    silent = scene.drove
    assert scene.ran(silent, scene.stands(silent).moment) < 0.4
    for _ in range(10):
        assert scene.obeyed(scene.command()) <= 4.0 * PERIOD, "a late command was obeyed for long"
    before, left = guard.log.count(PARKED), scene.leave()
    parked(guard, before + 1)
    assert scene.newest().speed == 0.0
    assert said_for_half_a_second(scene, scene.zeros(left))
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}, "driven by hand"
    assert "THE AGENT IS SILENT" in ended(guard)


def test_a_guard_that_is_ended_and_started_again_does_not_brake_a_healthy_agent(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    assert scene.drive(0.5, alive=True)[-1].speed == SPEED
    with scene.driving(alive=True):
        guards = [scene.guard()]
        scene.kept(1.0)
        ended(guards[0])
        guards.append(scene.guard())
        scene.kept(1.0)
        guards[1].signal(signal.SIGKILL)
        scene.kept(0.5)
        guards.append(scene.guard())
        scene.kept(1.0)
        ended(guards[2])
        scene.kept(0.5)
    assert {one.speed for one in scene.wheels() if scene.healthy(one.moment)} == {SPEED}
    assert not [moment for moment in scene.zeros() if scene.healthy(moment)]


def test_a_guard_that_is_ended_while_it_brakes_has_zero_as_its_last_word(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    guard = scene.guard()
    scene.drive(0.5, alive=True)
    silent = scene.drove

    def slowly() -> bool:
        """Whether by now it says zero each second only, and has just done so."""
        zeros = scene.zeros(silent)
        return len(zeros) > 2 and zeros[-2] - zeros[0] > BRAKING - SLOW and zeros[-1] - zeros[-2] > 0.9 * SLOW

    until(slowly)
    sent = scene.command()
    until(lambda: SPEED in {one.speed for one in scene.wheels(sent)})  # it has come
    assert "SIGTERM" in ended(guard)
    until(lambda: scene.last_word() == 0.0)
    stood = scene.stands(sent).moment
    assert scene.newest().speed == 0.0
    assert {one.speed for one in scene.wheels(stood)} == {0.0}


def test_a_robot_that_nobody_guarded_until_now_is_parked_once(scene: Scene) -> None:
    link = free_endpoint()
    guard = scene.guard(endpoint=link)  # before there is a router
    scene.robot()
    scene.listen()
    with scene.driving(alive=False, period=4.0 * PERIOD):  # so that it stands for a while in between
        until(lambda: SPEED in {one.speed for one in scene.wheels()})
        unguarded = time.time()
        with Relay(scene.endpoint, link):
            parked(guard)
            assert 0.0 in {one.speed for one in scene.wheels(unguarded)}
            assert said_for_half_a_second(scene, scene.zeros())
            over = scene.zeros()[-1]
            scene.kept(4.0 * PERIOD)  # until it has been told to go on
            assert {one.speed for one in scene.kept(1.0)} == {SPEED}
            assert not scene.zeros(over)
            assert "driven by hand" in ended(guard)


@both
def test_an_agent_that_is_told_to_end_takes_its_leave_so_the_robot_may_be_driven_by_hand(
    scene: Scene,
) -> None:
    scene.robot()
    guard = scene.guard()
    parked(guard)
    links = ["-l", free_endpoint(), "-e", free_endpoint(), "--robot-connect", scene.endpoint]
    began = time.time()
    flags = [str(scene.file), "--robot", "robot2", *links]
    with started("agent", *flags, nice=NICE["agent"]) as agent:
        agent.event("ready")
        until(lambda: len(scene.signs(began)) > 20)
        agent.signal(signal.SIGTERM)
        assert agent.event("summary")["robot"]["published"][LIFE] > 10
    until(lambda: guard.log.rstrip().endswith(PARKED))
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    log = ended(guard)
    assert "watching" in log
    assert log.count("SILENT") <= gaps(scene.signs(began)), "it took its leave too late, or not at all"


@both
def test_once_stops_a_robot_and_takes_leave_for_an_agent_that_died(scene: Scene) -> None:
    scene.robot()
    guard = scene.guard()
    scene.drive(1.0, alive=True)
    scene.stands(scene.drove)
    before = guard.log.count(PARKED)
    once = scene.guard("--once")
    published = once.event("summary")["robot"]["published"]
    assert set(published) == {COMMAND, LIFE}
    assert 1 < published[COMMAND] <= PARKING / PERIOD
    assert published[LIFE] == 1
    assert once.wait() == 0
    parked(guard, before + 1)
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    assert "driven by hand" in ended(guard)


def test_once_stops_a_robot_that_has_no_guard(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    assert scene.drive(0.5, alive=True)[-1].speed == SPEED
    assert scene.guard("--once").wait() == 0
    assert scene.newest().speed == 0.0
    assert said_for_half_a_second(scene, scene.zeros())
    assert {one.speed for one in scene.wheels(scene.zeros()[-1])} == {0.0}


def test_once_says_by_its_exit_code_that_no_robot_listened(scene: Scene) -> None:
    started_at = time.monotonic()
    assert scene.guard("--once").wait() == 1
    with Bus(BusConfig(listen=(scene.endpoint,), mode="router")):
        assert scene.guard("--once").wait() == 1
    assert time.monotonic() - started_at < 20.0


def test_a_guard_tells_systemd_that_it_is_ready_that_it_lives_and_that_it_ends(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(30.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        guard = scene.guard()
        assert systemd.recv(4096) == b"READY=1"
        assert [systemd.recv(4096) for _ in range(5)] == [b"WATCHDOG=1"] * 5
        ended(guard)
        while (word := systemd.recv(4096)) == b"WATCHDOG=1":
            pass
        assert word.startswith(b"STOPPING=1")


def test_a_robot_that_has_no_agent_is_refused_by_name() -> None:
    for name in ("robot1", "robot9"):
        with started("agent.robots.guard", "six_robots", "--robot", name) as child:
            assert child.wait() == 2
            why = f"--robot '{name}': must be one of robot2, robot3, robot4, robot5, robot6"
            assert child.errors == f"guard {name}: {why}\n"
