"""An agent as a real process between its robot's router and the fleet."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from formation.mission.file import parse, read
from formation.mission.model import Mission
from formation.protocol import order
from formation.protocol.order import OperatorReply
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
COMMAND, RECEIVED, PLACE, LIFE, STATUS = (
    f"robot2/{name}" for name in ("cmd_vel", "odom", "position", "alive", "status")
)


class Around:
    """What the test plays around an agent of robot2: its robot, which is the router, and the fleet."""

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
            for key in (PLACE, LIFE, STATUS, COMMAND):  # the agent asks who listens to the last
                bus.subscribe(address(key).topic, key)
            bus.advertise(ODOM, RECEIVED)
            yield bus

    @contextmanager
    def fleet(self) -> Iterator[Bus]:
        with Bus(BusConfig(connect=(self.agent_end,)), self.in_fleet) as bus:
            for key in (COMMAND, PLACE, RECEIVED, STATUS):
                bus.subscribe(key)
            yield bus

    def drive(self, robot: RobotBus, times: int) -> list[bytes]:
        """Say odometry, each time when the agent has taken the last; what was said."""
        result = []
        until(lambda: bool(robot.routed(RECEIVED)))
        for _ in range(times):
            before = self.in_fleet.received[RECEIVED]
            result.append(encode(Odometry(time.time(), -1.5 + 2.0j, 1 + 0j, 0.0, 0.0)))
            robot.publish(RECEIVED, result[-1])
            until(lambda before=before: self.in_fleet.received[RECEIVED] > before)  # type: ignore[misc]
        return result

    def link(self) -> str:
        """The link to the robot, by the agent's newest status; empty before the first."""
        self.listen()
        result = payloads(self.from_fleet, STATUS)
        return decode(Diagnostics, result[-1]).statuses[0].values["link"] if result else ""

    def listen(self) -> None:
        """Take what has arrived on both sides."""
        self.from_robot += self.at_robot.drain()
        self.from_fleet += self.in_fleet.drain()

    def finish_reading(self, summary: dict[str, Any]) -> None:
        """The same, when all has arrived that an agent which has ended told its robot."""
        reported: dict[str, int] = summary["robot"]["published"]
        until(lambda: all(self.at_robot.received[key] >= count for key, count in reported.items()))
        self.listen()


@pytest.fixture(params=["ros2dds", "rmw_zenoh"])
def around(tmp_path: Path, request: pytest.FixtureRequest) -> Around:
    return Around(tmp_path, request.param)


def payloads(samples: Sequence[Sample], key: str) -> list[bytes]:
    return [sample.payload for sample in samples if sample.key == key]


@pytest.mark.smoke
def test_agent_commands_robot_and_publishes_inputs_to_fleet(around: Around) -> None:
    with around.robot() as robot, around.agent() as child, around.fleet():
        until(lambda: around.link() == "connected")
        result = around.drive(robot, 5)
        until(lambda: around.at_robot.received[PLACE] == 5 and around.in_fleet.received[PLACE] == 5)
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
        around.finish_reading(summary)
    assert payloads(around.from_fleet, RECEIVED) == result
    assert len(payloads(around.from_robot, LIFE)) >= 5
    orders = [sample.attachment for sample in around.from_fleet if sample.key == PLACE]
    assert all(order.decode(order.PositionAttachment, attachment or b"") for attachment in orders)
    assert payloads(around.from_robot, PLACE) == payloads(around.from_fleet, PLACE)
    places = [decode(Pose, payload).position for payload in payloads(around.from_robot, PLACE)]
    assert places == [-1.5 + 2.0j] * 5
    commands = payloads(around.from_robot, COMMAND)
    assert commands[-1] == encode(Twist(0.0, 0.0))
    assert summary["robot"]["published"][COMMAND] == len(commands)
    assert summary["robot"]["received"] == {RECEIVED: 5}
    assert summary["published"][RECEIVED] == 5
    assert LIFE not in summary["published"]
    assert (summary["received"], summary["refused"]) == ({}, {})


@pytest.mark.smoke
def test_a_readonly_agent_does_everything_but_move(around: Around) -> None:
    with around.robot() as robot, around.agent("--readonly") as child, around.fleet():
        until(lambda: around.link() == "connected")
        around.drive(robot, 5)
        until(lambda: around.at_robot.received[PLACE] == 5 and around.in_fleet.received[COMMAND] >= 5)
        child.signal(signal.SIGTERM)
        summary = child.event("summary")
        around.finish_reading(summary)
    assert {sample.key for sample in around.from_robot} == {PLACE, STATUS}
    assert summary["published"][COMMAND] >= 5
    assert not {COMMAND, LIFE} & set(summary["robot"]["published"])
    newest = decode(Diagnostics, payloads(around.from_fleet, STATUS)[0]).statuses[0]
    assert "readonly" in newest.message


def test_agent_starts_without_robot_and_reports_link(around: Around) -> None:
    with around.agent(), around.fleet():
        until(lambda: around.in_fleet.received[STATUS] > 0)
        assert around.link() == "not_connected"
        with around.robot() as robot:
            until(lambda: around.link() == "connected")
            around.drive(robot, 2)
        until(lambda: around.link() == "not_connected")
        with around.robot() as robot:
            until(lambda: around.link() == "connected")
            around.drive(robot, 2)


def test_a_route_that_is_lost_is_named_in_the_status(tmp_path: Path) -> None:
    around = Around(tmp_path)
    naming = Naming.of(around.mission.robots, ["robot2"])
    with (
        RobotBus((around.robot_end,), naming, Mailbox(), mode="router"),
        around.agent(),
        around.fleet(),
    ):
        until(lambda: around.link() == "no_listener")


def test_an_operator_is_answered_over_the_fleets_bus(tmp_path: Path) -> None:
    around = Around(tmp_path)
    with around.agent(), around.fleet() as bus:
        until(lambda: around.in_fleet.received[STATUS] > 0)
        (reply,) = bus.ask("robot2/order", b'{"do":"stop"}', timeout=PATIENCE)
        assert order.decode(OperatorReply, reply.payload).mode == "stop"


def test_stop_survives_killed_agent_until_its_release(tmp_path: Path) -> None:
    around, state = Around(tmp_path), ("--state", str(tmp_path / "state"))
    modes = []

    def ask(bus: Bus, request: bytes) -> OperatorReply:
        before = around.in_fleet.received[STATUS]
        until(lambda: around.in_fleet.received[STATUS] > before)
        (reply,) = bus.ask("robot2/order", request, timeout=PATIENCE)
        return order.decode(OperatorReply, reply.payload)

    with around.agent(*state) as child, around.fleet() as bus:
        modes.append(ask(bus, b'{"do":"stop","id":"s"}').mode)
        child.signal(signal.SIGKILL)
    with around.agent(*state), around.fleet() as bus:
        modes += [ask(bus, request).mode for request in (b'{"do":"run"}', b'{"do":"release","ends":["s"]}')]
    assert modes == ["stop", "stop", "hold"]


def test_two_agents_of_one_robot_notice_each_other(tmp_path: Path) -> None:
    around = Around(tmp_path)
    second = ("-l", free_endpoint(), "-e", around.agent_end, "--robot-connect", around.robot_end)
    with (
        around.robot() as robot,
        around.agent(),
        started("formation.agent", str(around.file), "--robot", "robot2", *second),
        around.fleet(),
    ):
        until(lambda: around.link() == "connected")
        around.drive(robot, 2)

        def noticed() -> bool:
            around.listen()
            return b"another agent" in payloads(around.from_fleet, STATUS)[-1]

        until(noticed)


def test_second_agent_for_same_robot_ends_with_error(tmp_path: Path) -> None:
    around = Around(tmp_path)
    with (
        around.agent(),
        started("formation.agent", str(around.file), "--robot", "robot2", "-l", around.agent_end) as second,
    ):
        assert second.wait() == 2
        assert second.errors == (
            f"robot2: cannot listen on {around.agent_end}: the address is in use;"
            " is there a second agent robot2 on this machine?\n"
        )
