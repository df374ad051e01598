"""An agent as a real process between its robot's router and the fleet."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from formation.agent.__main__ import main
from formation.mission.file import parse, read
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.request import OperatorReply
from formation.ros2.messages import Diagnostics, Odometry, Pose, Twist, decode, encode
from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros, address
from formation.topics import ODOM
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from formation.wire import Sample
from tests.support.child import PATIENCE, Child, free_endpoint, started, until

pytestmark = pytest.mark.processes
COMMAND, ODOM_KEY, PLACE, LIFE, STATUS = (
    f"robot2/{name}" for name in ("cmd_vel", "odom", "position", "alive", "status")
)


class Scene:
    """An agent of robot2, and what the test plays for it: its robot, which is the router, and the fleet."""

    def __init__(self, folder: Path, ros: Ros = "ros2dds") -> None:
        text, source = read("six_robots")
        text = text.replace("[robots.robot2]\n", f'[robots.robot2]\nros = "{ros}"\n')
        self.file = folder / "mission.toml"
        self.file.write_text(text, encoding="utf-8")
        self.mission: Mission = parse(text, source)
        self.agent_end, self.robot_end = free_endpoint(), free_endpoint()
        self.at_robot, self.in_fleet = Mailbox(), Mailbox()
        self.from_robot, self.from_fleet = list[Sample](), list[Sample]()

    @contextmanager
    def agent(self, *flags: str) -> Iterator[Child]:
        ends = ("-l", self.agent_end, "--robot-connect", self.robot_end)
        with started("formation.agent", str(self.file), "--robot", "robot2", *ends, *flags) as child:
            assert child.event("ready") == {"event": "ready", "process": "agent robot2"}
            yield child

    @contextmanager
    def robot(self) -> Iterator[RobotBus]:
        naming = Naming.of(self.mission.robots, ["robot2"])
        with RobotBus((self.robot_end,), naming, self.at_robot, mode="router", node="robot") as bus:
            for key in (PLACE, LIFE, STATUS, COMMAND):  # the agent checks for listeners to the last
                bus.subscribe(address(key).topic, key)
            bus.advertise(ODOM, ODOM_KEY)
            yield bus

    @contextmanager
    def fleet(self) -> Iterator[Bus]:
        with Bus(BusConfig(connect=(self.agent_end,)), self.in_fleet) as bus:
            for key in (COMMAND, PLACE, ODOM_KEY, STATUS):
                bus.subscribe(key)
            yield bus

    def publish_odometry(self, robot: RobotBus, times: int) -> list[bytes]:
        """Publish odometry, each time after the agent has received the last; return the payloads."""
        result = []
        until(lambda: bool(robot.routed(ODOM_KEY)))
        for _ in range(times):
            before = self.in_fleet.received[ODOM_KEY]
            result.append(encode(Odometry(time.time(), -1.5 + 2.0j, 1 + 0j, 0.0, 0.0)))
            robot.publish(ODOM_KEY, result[-1])
            until(lambda before=before: self.in_fleet.received[ODOM_KEY] > before)  # type: ignore[misc]
        return result

    def link(self) -> str:
        """Return the link to the robot by the agent's newest status; empty before the first."""
        self.drain()
        result = payloads(self.from_fleet, STATUS)
        return decode(Diagnostics, result[-1]).statuses[0].values["link"] if result else ""

    def drain(self) -> None:
        """Store what has arrived at the robot and in the fleet."""
        self.from_robot += self.at_robot.drain()
        self.from_fleet += self.in_fleet.drain()

    def drain_to_end(self, summary: dict[str, Any]) -> None:
        """Drain after the robot has received everything that the ended agent published to it."""
        reported: dict[str, int] = summary["robot"]["published"]
        until(lambda: all(self.at_robot.received[key] >= count for key, count in reported.items()))
        self.drain()


@pytest.fixture(params=["ros2dds", "rmw_zenoh"])
def scene(tmp_path: Path, request: pytest.FixtureRequest) -> Scene:
    return Scene(tmp_path, request.param)


def payloads(samples: Sequence[Sample], key: str) -> list[bytes]:
    return [sample.payload for sample in samples if sample.key == key]


@pytest.mark.smoke
def test_agent_commands_robot_and_publishes_inputs_to_fleet(scene: Scene) -> None:
    with scene.robot() as robot, scene.agent() as child, scene.fleet():
        until(lambda: scene.link() == "connected")
        result = scene.publish_odometry(robot, 5)
        until(lambda: scene.at_robot.received[PLACE] == 5 and scene.in_fleet.received[PLACE] == 5)
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
        scene.drain_to_end(summary)
    assert payloads(scene.from_fleet, ODOM_KEY) == result
    assert len(payloads(scene.from_robot, LIFE)) >= 5
    orders = [sample.attachment for sample in scene.from_fleet if sample.key == PLACE]
    assert all(json_message.decode(PositionAttachment, attachment or b"") for attachment in orders)
    assert payloads(scene.from_robot, PLACE) == payloads(scene.from_fleet, PLACE)
    places = [decode(Pose, payload).position for payload in payloads(scene.from_robot, PLACE)]
    assert places == [-1.5 + 2.0j] * 5
    commands = payloads(scene.from_robot, COMMAND)
    assert commands[-1] == encode(Twist(0.0, 0.0))
    assert summary["robot"]["published"][COMMAND] == len(commands)
    assert summary["robot"]["received"] == {ODOM_KEY: 5}
    assert summary["published"][ODOM_KEY] == 5
    assert LIFE not in summary["published"]
    assert (summary["received"], summary["refused"]) == ({}, {})


@pytest.mark.smoke
def test_readonly_agent_sends_no_commands_to_robot(scene: Scene) -> None:
    with scene.robot() as robot, scene.agent("--readonly") as child, scene.fleet():
        until(lambda: scene.link() == "connected")
        scene.publish_odometry(robot, 5)
        until(lambda: scene.at_robot.received[PLACE] == 5 and scene.in_fleet.received[COMMAND] >= 5)
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
        scene.drain_to_end(summary)
    assert {sample.key for sample in scene.from_robot} == {PLACE, STATUS}
    assert summary["published"][COMMAND] >= 5
    assert not {COMMAND, LIFE} & set(summary["robot"]["published"])
    newest = decode(Diagnostics, payloads(scene.from_fleet, STATUS)[0]).statuses[0]
    assert "readonly" in newest.message


def test_agent_starts_without_robot_and_reports_link(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    naming = Naming.of(scene.mission.robots, ["robot2"])
    with scene.agent(), scene.fleet():
        until(lambda: scene.in_fleet.received[STATUS] > 0)
        assert scene.link() == "not_connected"
        with RobotBus((scene.robot_end,), naming, Mailbox(), mode="router"):  # no subscriber of cmd_vel
            until(lambda: scene.link() == "no_listener")
        until(lambda: scene.link() == "not_connected")
        with scene.robot() as robot:
            until(lambda: scene.link() == "connected")
            scene.publish_odometry(robot, 2)


def test_stop_survives_killed_agent_until_its_release(tmp_path: Path) -> None:
    scene, state = Scene(tmp_path), ("--state", str(tmp_path / "state"))
    modes = []

    def ask(bus: Bus, request: bytes) -> OperatorReply:
        before = scene.in_fleet.received[STATUS]
        until(lambda: scene.in_fleet.received[STATUS] > before)
        (reply,) = bus.ask("robot2/order", request, timeout=PATIENCE)
        return json_message.decode(OperatorReply, reply.payload)

    with scene.agent(*state) as child, scene.fleet() as bus:
        modes.append(ask(bus, b'{"do":"stop","id":"s"}').mode)
        child.signal(signal.SIGKILL)
    with scene.agent(*state), scene.fleet() as bus:
        modes += [ask(bus, request).mode for request in (b'{"do":"run"}', b'{"do":"release","ends":["s"]}')]
    assert modes == ["stop", "stop", "hold"]


def test_status_reports_another_agent_of_same_robot(tmp_path: Path) -> None:
    scene = Scene(tmp_path)
    second = ("-l", free_endpoint(), "-e", scene.agent_end, "--robot-connect", scene.robot_end)
    with (
        scene.robot() as robot,
        scene.agent(),
        started("formation.agent", str(scene.file), "--robot", "robot2", *second),
        scene.fleet(),
    ):
        until(lambda: scene.link() == "connected")
        scene.publish_odometry(robot, 2)

        def reported_other_agent() -> bool:
            scene.drain()
            return b"another agent" in payloads(scene.from_fleet, STATUS)[-1]

        until(reported_other_agent)


def test_second_agent_for_same_robot_ends_with_error(
    endpoint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with Bus(BusConfig(listen=(endpoint,))):
        assert main(["six_robots", "--robot", "robot2", "-l", endpoint]) == 2
    assert capsys.readouterr().err == (
        f"robot2: cannot listen on {endpoint}: the address is in use;"
        " is there a second agent robot2 on this machine?\n"
    )
