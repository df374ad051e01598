"""The robot's bus over real Zenoh, for each ROS 2 transport: messages, routes, a restarted router."""

from __future__ import annotations

import struct
import time
from contextlib import ExitStack

import pytest

from formation.ros2.messages import Odometry, Pose, Twist, encode
from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from formation.topics import ALIVE, CMD_VEL, ODOM, POSITION
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from formation.wire import BadMessage
from tests.processes.agent.robot_sides import (
    COMMAND,
    LIFE,
    ODOM_KEY,
    ODOMETRY,
    PLACE,
    TWIST,
    Listener,
    agent_on,
    mission_of,
    node,
    robot_on,
    tokens,
)
from tests.support.child import until

pytestmark = pytest.mark.processes
AT_REST, ELSEWHERE = encode(Twist(0.0, 0.0)), encode(Odometry(0.9, 1.0 + 1.0j, 1.0 + 0.0j, 0.0, 0.0))
TWIST_HASH = "RIHS01_9c45bf16fe0983d80e3cfe750d6835843d265a9a6c46bd2e609fcddde6fb8d2a"
ON_THE_WIRE = {
    "ros2dds": "robot2/cmd_vel",
    "rmw_zenoh": f"0/robot2/cmd_vel/geometry_msgs::msg::dds_::Twist_/{TWIST_HASH}",
}


def test_commands_and_odometry_arrive_under_logical_keys(
    endpoint: str, naming: Naming, stack: ExitStack
) -> None:
    robot, at_robot = robot_on(endpoint, naming)
    at_agent = Mailbox()
    agent = agent_on(endpoint, naming, at_agent)
    stack.enter_context(robot)
    stack.enter_context(agent)
    until(lambda: bool(agent.routed(COMMAND) and robot.routed(ODOM_KEY)))
    agent.publish(COMMAND, TWIST)
    robot.publish(ODOM_KEY, ODOMETRY)
    until(lambda: bool(at_agent.received and at_robot.received))
    assert [sample[:2] for sample in at_robot.drain()] == [(COMMAND, TWIST)]
    assert [sample[:2] for sample in at_agent.drain()] == [(ODOM_KEY, ODOMETRY)]
    assert agent.published == robot.received == at_robot.received == {COMMAND: 1}
    assert robot.published == agent.received == at_agent.received == {ODOM_KEY: 1}


def test_wire_format_matches_ros_and_publishers_count_separately(
    endpoint: str, ros: Ros, naming: Naming, stack: ExitStack
) -> None:
    robot, _ = robot_on(endpoint, naming)
    stack.enter_context(robot)
    ros_node = stack.enter_context(node(endpoint, "client"))
    commands = Listener(ros_node, ON_THE_WIRE[ros])
    places = Listener(ros_node, naming.wire(PLACE))
    agent = stack.enter_context(agent_on(endpoint, naming))
    agent.advertise(POSITION, PLACE)
    until(lambda: bool(agent.routed(COMMAND) and agent.routed(PLACE)))
    before = time.time_ns()
    for _ in range(3):
        agent.publish(COMMAND, TWIST)
    agent.publish(PLACE, encode(Pose(1.0, 0j, 1 + 0j)))
    until(lambda: len(commands.samples) == 3 and len(places.samples) == 1)
    assert commands.payloads == [TWIST] * 3
    attachments = [attachment for _, attachment in commands.samples + places.samples]
    if ros == "ros2dds":
        assert attachments == [None] * 4
        return
    read = [struct.unpack("<qqB16s", attachment or b"") for attachment in attachments]
    assert [sequence for sequence, *_ in read] == [1, 2, 3, 1]
    assert all(before - 1_000_000 <= stamp <= time.time_ns() for _, stamp, *_ in read)
    assert {length for *_, length, _ in read} == {16}
    gids = [gid for *_, gid in read]
    assert gids[0] == gids[1] == gids[2] != gids[3]


def test_missing_router_blocks_nothing_until_it_appears(
    endpoint: str, ros: Ros, naming: Naming, stack: ExitStack
) -> None:
    start = time.monotonic()
    agent = stack.enter_context(agent_on(endpoint, naming))
    assert (agent.connected, agent.routed(COMMAND)) == (False, None)
    agent.publish(COMMAND, TWIST)
    assert time.monotonic() - start < 0.2
    time.sleep(1.2)  # so that dialling has failed more than once
    assert (agent.published, agent.connected) == ({}, False)
    robot, at_robot = robot_on(endpoint, naming)
    stack.enter_context(robot)
    assert until(lambda: bool(agent.routed(COMMAND))) < 3.0
    agent.publish(COMMAND, TWIST)
    until(lambda: bool(at_robot.received))
    ros_node = stack.enter_context(node(endpoint, "client"))
    seen = tokens(ros_node)
    assert (seen == set()) == (ros == "ros2dds")
    if ros == "rmw_zenoh":
        assert any("/MP/" in token and "_formation_agent/%robot2%cmd_vel/" in token for token in seen)


def test_keys_can_be_declared_after_session_is_open(
    endpoint: str, ros: Ros, naming: Naming, stack: ExitStack
) -> None:
    robot, _ = robot_on(endpoint, naming)
    stack.enter_context(robot)
    mailbox = Mailbox()
    agent = stack.enter_context(RobotBus((endpoint,), naming, mailbox))
    until(lambda: agent.connected)
    agent.advertise(CMD_VEL, COMMAND)
    agent.subscribe(ODOM, ODOM_KEY)
    until(lambda: bool(agent.routed(COMMAND) and robot.routed(ODOM_KEY)))
    robot.publish(ODOM_KEY, ODOMETRY)
    until(lambda: mailbox.received[ODOM_KEY] == 1)
    if ros == "rmw_zenoh":
        ours = [token for token in tokens(stack.enter_context(node(endpoint, "client"))) if "agent" in token]
        assert sorted(token.split("/")[5] for token in ours) == ["MP", "MS", "NN"]
        assert len({token.split("/")[4] for token in ours}) == 3


@pytest.mark.parametrize("ros", ["rmw_zenoh"])  # it has tokens besides
def test_agent_declares_everything_again_after_router_restart(
    endpoint: str, naming: Naming, stack: ExitStack
) -> None:
    mailbox = Mailbox()
    robot, _ = robot_on(endpoint, naming)
    agent = stack.enter_context(agent_on(endpoint, naming, mailbox))
    until(lambda: bool(agent.routed(COMMAND)))
    before = tokens(stack.enter_context(node(endpoint, "client")))
    robot.close()
    assert until(lambda: not agent.connected) < 1.0
    assert agent.routed(COMMAND) is None
    agent.publish(COMMAND, TWIST)  # there is no router
    time.sleep(2.5)  # longer than any pause between two attempts
    robot, at_robot = robot_on(endpoint, naming)
    stack.enter_context(robot)
    assert until(lambda: bool(agent.routed(COMMAND) and robot.routed(ODOM_KEY))) < 3.0
    agent.publish(COMMAND, TWIST)
    robot.publish(ODOM_KEY, ODOMETRY)
    until(lambda: at_robot.received[COMMAND] == 1 and mailbox.received[ODOM_KEY] == 1)
    with node(endpoint, "client") as ros_node:
        agents = {token for token in before if "formation_agent" in token}
        until(lambda: agents <= tokens(ros_node))
        assert agents


def test_route_status_follows_its_listeners(endpoint: str, ros: Ros, naming: Naming) -> None:
    mailbox = Mailbox()
    with RobotBus((endpoint,), naming, mailbox, mode="router"), agent_on(endpoint, naming) as agent:
        until(lambda: agent.connected)
        assert agent.routed(COMMAND) is False
        with node(endpoint, "client") as robot:
            listener = Listener(robot, ON_THE_WIRE[ros])
            until(lambda: bool(agent.routed(COMMAND)))
            agent.publish(COMMAND, TWIST)
            until(lambda: listener.payloads == [TWIST])
        until(lambda: agent.routed(COMMAND) is False)
        assert agent.connected


def test_watchdog_receives_alive_but_counts_as_no_command_listener(
    endpoint: str, naming: Naming, stack: ExitStack
) -> None:
    stack.enter_context(RobotBus((endpoint,), naming, Mailbox(), mode="router"))
    agent = stack.enter_context(agent_on(endpoint, naming))
    agent.advertise(ALIVE, LIFE)
    at_watchdog = Mailbox()
    watchdog = stack.enter_context(RobotBus((endpoint,), naming, at_watchdog, node="formation_watchdog"))
    watchdog.advertise(CMD_VEL, COMMAND)
    watchdog.subscribe(ALIVE, LIFE)
    until(lambda: bool(agent.routed(LIFE)) and watchdog.connected)
    assert agent.routed(COMMAND) is False
    assert watchdog.routed(COMMAND) is False
    with node(endpoint, "client") as robot:
        listener = Listener(robot, naming.wire(COMMAND))
        until(lambda: bool(agent.routed(COMMAND) and watchdog.routed(COMMAND)))
        agent.publish(COMMAND, TWIST)
        agent.publish(LIFE, b"\x00\x01\x00\x00" + bytes(8))
        watchdog.publish(COMMAND, TWIST)
        until(lambda: len(listener.samples) == 2 and at_watchdog.received[LIFE] == 1)
        gids = {(attachment or b"")[17:] for _, attachment in listener.samples}
    assert len(gids) == (1 if gids == {b""} else 2)
    assert set(at_watchdog.received) == {LIFE}


def test_ordinary_peer_node_communicates_through_the_router(
    endpoint: str, ros: Ros, naming: Naming, stack: ExitStack
) -> None:
    stack.enter_context(RobotBus((endpoint,), naming, Mailbox(), mode="router"))
    mailbox = Mailbox()
    agent = stack.enter_context(agent_on(endpoint, naming, mailbox))
    ros_node, other = stack.enter_context(node(endpoint)), stack.enter_context(node(endpoint))
    listener, second = Listener(ros_node, ON_THE_WIRE[ros]), Listener(other, ON_THE_WIRE[ros])
    publisher = ros_node.declare_publisher(naming.wire(ODOM_KEY))
    until(lambda: bool(agent.routed(COMMAND)) and bool(publisher.matching_status.matching))  # type: ignore[attr-defined]
    # One of two subscribers is enough for a route, and routes change while peers link: repeat other
    # messages until all have received one.
    sent = 0
    while not (listener.samples and second.samples and mailbox.received):
        agent.publish(COMMAND, AT_REST)
        publisher.put(ELSEWHERE)
        sent += 1
        time.sleep(0.01)
    agent.publish(COMMAND, TWIST)
    publisher.put(ODOMETRY)
    until(lambda: TWIST in listener.payloads and TWIST in second.payloads)
    until(lambda: any(payload == ODOMETRY for _, payload, *_ in mailbox.drain()))
    time.sleep(0.1)
    for one in (listener, second):
        assert one.payloads.count(TWIST) == 1  # once, though there are several paths
    assert set(mailbox.received) == {ODOM_KEY}
    assert mailbox.received[ODOM_KEY] <= sent + 1


def test_robots_behind_one_router_with_different_transports_stay_separate(endpoint: str) -> None:
    mission = mission_of("ros2dds", "rmw_zenoh")
    both = Naming.of(mission.robots, ["robot2", "robot3"])
    at_robots, at_two, at_three = Mailbox(), Mailbox(), Mailbox()
    with (
        RobotBus((endpoint,), both, at_robots, mode="router") as robots,
        RobotBus((endpoint,), Naming.of(mission.robots, ["robot2"]), at_two) as two,
        RobotBus((endpoint,), Naming.of(mission.robots, ["robot3"]), at_three) as three,
    ):
        for name, bus in (("robot2", two), ("robot3", three)):
            bus.advertise(CMD_VEL, CMD_VEL.key(name))
            bus.subscribe(ODOM, ODOM.key(name))
            robots.advertise(ODOM, ODOM.key(name))
            robots.subscribe(CMD_VEL, CMD_VEL.key(name))
        until(lambda: bool(two.routed(CMD_VEL.key("robot2")) and three.routed(CMD_VEL.key("robot3"))))
        until(lambda: bool(robots.routed(ODOM.key("robot2")) and robots.routed(ODOM.key("robot3"))))
        three.publish(CMD_VEL.key("robot3"), TWIST)
        robots.publish(ODOM.key("robot2"), ODOMETRY)
        robots.publish(ODOM.key("robot3"), ODOMETRY)
        until(lambda: bool(at_robots.received and at_two.received and at_three.received))
        assert at_robots.received == {CMD_VEL.key("robot3"): 1}
        assert at_two.received == {ODOM.key("robot2"): 1}
        assert at_three.received == {ODOM.key("robot3"): 1}


def test_payload_without_cdr_header_is_refused(endpoint: str, naming: Naming, stack: ExitStack) -> None:
    agent = stack.enter_context(agent_on(endpoint, naming))
    _check_invalid_payloads_are_refused(agent)  # the session is not open yet
    robot, at_robot = robot_on(endpoint, naming)
    stack.enter_context(robot)
    until(lambda: bool(agent.routed(COMMAND)))
    _check_invalid_payloads_are_refused(agent)
    agent.publish(COMMAND, TWIST)
    until(lambda: bool(at_robot.received))
    assert [sample.payload for sample in at_robot.drain()] == [TWIST]


def _check_invalid_payloads_are_refused(agent: RobotBus) -> None:
    for payload in (b"", b"\x00\x01\x00\x00", b"{}", b'{"speed": 1}', bytes(3)):
        with pytest.raises(BadMessage, match=r"without a CDR header on robot2/cmd_vel"):
            agent.publish(COMMAND, payload)
