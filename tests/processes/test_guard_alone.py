"""A guard beside a simulated robot, whose agent is played here: whom it stops, and whom it leaves alone."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest

from agent.alive import FAREWELL
from agent.robots.guard.core import BRAKING, SLOW
from formation.mission import Mission
from formation.mission_file import load, read
from formation.ros2.messages import Number, Odometry, Twist, TwistStamped, decode, encode
from formation.ros2.naming import Naming
from formation.topics import ALIVE, CMD_VEL, ODOM, command_topic
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from tests.processes.bus_tools import until
from tests.processes.child import Child, free_endpoint, started

pytestmark = pytest.mark.processes
PERIOD = 0.05
SPEED = 0.3
COMMAND, LIFE, HEARD = (topic.key("robot2") for topic in (CMD_VEL, ALIVE, ODOM))


class Wheel(NamedTuple):
    """One odometry message."""

    moment: float
    """[s, monotonic]"""
    speed: float


class Scene:
    """A mission in one of ROS 2's spellings, its second robot, and who drives that."""

    def __init__(self, stack: ExitStack, folder: Path, ros: str, kind: str) -> None:
        text, _ = read("six_robots")
        table = "[robots.robot2]\n"
        assert table in text
        self.file = folder / "mission.toml"
        self.file.write_text(text.replace(table, f'{table}ros = "{ros}"\ncmd_vel = "{kind}"\n'), "utf-8")
        self.mission: Mission = load(self.file)
        self.endpoint = free_endpoint()
        self._stack, self._mailbox = stack, Mailbox()
        naming = Naming.of(self.mission, ["robot2"])
        self.bus = stack.enter_context(RobotBus((self.endpoint,), naming, self._mailbox, node="driver"))
        self.bus.advertise(command_topic(self.mission.robots["robot2"].cmd_vel), COMMAND)
        self.bus.advertise(ALIVE, LIFE)
        self.bus.subscribe(ODOM, HEARD)
        self.wheels: list[Wheel] = []

    def robot(self) -> Child:
        flags = ["--robot", "robot2", "-l", self.endpoint]
        child = self._stack.enter_context(started("agent.robots", str(self.file), *flags))
        child.event("ready")
        until(lambda: bool(self.bus.routed(COMMAND)))
        return child

    def guard(self, *flags: str) -> Child:
        links = ["--robot", "robot2", "--robot-connect", self.endpoint]
        child = self._stack.enter_context(started("agent.robots.guard", str(self.file), *links, *flags))
        if "--once" not in flags:
            child.event("ready")
        return child

    def drive(self, seconds: float, *, alive: bool) -> list[Wheel]:
        """Drive straight on, as an agent that is `alive` or as somebody else; what the wheels did."""
        start = time.monotonic()
        while (now := time.monotonic()) < start + seconds:
            self.command()
            if alive:
                self.bus.publish(LIFE, encode(Number(now)))
            time.sleep(PERIOD)
        return self.looked(start)

    def command(self) -> None:
        stamped = self.mission.robots["robot2"].cmd_vel == "twist_stamped"
        command = TwistStamped(time.time(), SPEED, 0.0) if stamped else Twist(SPEED, 0.0)
        self.bus.publish(COMMAND, encode(command))

    def leave(self) -> None:
        self.bus.publish(LIFE, encode(Number(FAREWELL)))

    def looked(self, since: float) -> list[Wheel]:
        """What the wheels did since [s, monotonic], leaving out the first two periods."""
        self.wheels += [
            Wheel(one.arrived, decode(Odometry, one.payload).speed) for one in self._mailbox.drain()
        ]
        return [one for one in self.wheels if one.moment > since + 2.0 * PERIOD]

    def coast(self, seconds: float) -> list[Wheel]:
        """Say nothing for a while; what the wheels did."""
        start = time.monotonic()
        time.sleep(seconds)
        return self.looked(start)


TWIST = ("ros2dds", "twist")
both = pytest.mark.parametrize(
    "scene", [TWIST, ("rmw_zenoh", "twist_stamped")], ids=lambda wire: wire[0], indirect=True
)
"""Both spellings, each with another type of command."""


@pytest.fixture
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(stack, tmp_path, *getattr(request, "param", TWIST))


def ended(child: Child) -> tuple[int, str]:
    """How many commands a guard gave in its life, and its log."""
    child.signal(signal.SIGTERM)
    published = child.event("summary")["robot"]["published"]
    assert child.wait() == 0
    assert set(published) <= {COMMAND}
    return published.get(COMMAND, 0), child.errors


@both
def test_a_robot_whose_agent_fell_silent_stands_whatever_comes_late_until_the_agent_took_its_leave(
    scene: Scene,
) -> None:
    scene.robot()
    guard = scene.guard()
    assert {one.speed for one in scene.drive(1.0, alive=True)} == {SPEED}
    coasting = scene.coast(1.0)
    assert coasting[-1].speed == 0.0
    assert min(one.moment for one in coasting if one.speed == 0.0) < coasting[0].moment + 0.25
    for _ in range(10):
        scene.command()
        assert scene.coast(4.0 * PERIOD)[-1].speed == 0.0, "a late command was obeyed for long"
    scene.leave()
    assert [one.speed for one in scene.coast(0.8)][-1] == 0.0
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}, "driven by hand"
    assert "THE AGENT IS SILENT" in ended(guard)[1]


def test_a_guard_that_is_ended_and_started_again_does_not_brake_a_healthy_agent(scene: Scene) -> None:
    scene.robot()
    assert scene.drive(0.5, alive=True)[-1].speed == SPEED
    guards = [scene.guard()]
    while_guarded = scene.drive(1.0, alive=True)
    assert ended(guards[0])[0] == 0
    guards.append(scene.guard())
    while_guarded += scene.drive(1.0, alive=True)
    guards[1].signal(signal.SIGKILL)
    while_guarded += scene.drive(0.5, alive=True)
    guards.append(scene.guard())
    while_guarded += scene.drive(1.0, alive=True)
    assert ended(guards[2])[0] == 0
    assert {one.speed for one in while_guarded} == {SPEED}


def test_a_guard_that_is_ended_while_it_brakes_has_zero_as_its_last_word(scene: Scene) -> None:
    scene.robot()
    guard = scene.guard()
    scene.drive(0.5, alive=True)
    scene.coast(BRAKING + 1.5 * SLOW)  # by now it says zero each second only, and has just done so
    sent = time.monotonic()
    scene.command()
    until(lambda: SPEED in {one.speed for one in scene.looked(sent - 2.0 * PERIOD)})  # it has come
    said, log = ended(guard)
    assert said == pytest.approx(BRAKING / PERIOD + 2.0, abs=3.0)
    assert "SIGTERM" in log
    assert scene.coast(0.3)[-1].speed == 0.0


def test_a_robot_that_nobody_guarded_until_now_is_parked_once(scene: Scene) -> None:
    guard = scene.guard()  # before there is a router
    scene.robot()
    first = scene.drive(2.5, alive=False)
    assert 0.0 in {one.speed for one in first}
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    said, log = ended(guard)
    assert said == 10
    assert "driven by hand" in log


@both
def test_an_agent_that_is_told_to_end_takes_its_leave_so_the_robot_may_be_driven_by_hand(
    scene: Scene,
) -> None:
    scene.robot()
    guard = scene.guard()
    time.sleep(1.5)  # until it has parked the robot
    links = ["-l", free_endpoint(), "-e", free_endpoint(), "--robot-connect", scene.endpoint]
    with started("agent", str(scene.file), "--robot", "robot2", *links) as agent:
        agent.event("ready")
        time.sleep(1.0)
        agent.signal(signal.SIGTERM)
        assert agent.event("summary")["robot"]["published"][LIFE] > 10
    time.sleep(0.8)
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    _, log = ended(guard)
    assert "watching" in log
    assert "SILENT" not in log


@both
def test_once_stops_a_robot_and_takes_leave_for_an_agent_that_died(scene: Scene) -> None:
    scene.robot()
    guard = scene.guard()
    scene.drive(1.0, alive=True)
    scene.coast(0.5)
    once = scene.guard("--once")
    assert once.event("summary")["robot"]["published"] == {COMMAND: 10, LIFE: 1}
    assert once.wait() == 0
    time.sleep(0.8)
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    assert "driven by hand" in ended(guard)[1]


def test_once_stops_a_robot_that_has_no_guard(scene: Scene) -> None:
    scene.robot()
    assert scene.drive(0.5, alive=True)[-1].speed == SPEED
    assert scene.guard("--once").wait() == 0
    assert scene.coast(0.3)[-1].speed == 0.0


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
