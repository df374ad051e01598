"""TurtleBots, played byte for byte, under real agent and leader processes; and the player itself."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
import zenoh

from formation.mission.file import parse, read
from formation.ros2 import tokens
from formation.ros2.messages import Odometry, Twist, TwistStamped, decode, encode
from formation.ros2.naming import Naming
from formation.topics import CMD_VEL, ODOM
from tests.processes.agent.turtlebot3 import TurtleBot3, Wire
from tests.support.bus_tools import until
from tests.support.child import free_endpoint
from tests.support.edited import edited

pytestmark = pytest.mark.processes
VARIANTS = [(ros, kind) for ros in ("ros2dds", "rmw_zenoh") for kind in ("twist", "twist_stamped")]
PAIR = read("turtlebot3_pair")[0]
START, HEADING = -0.9 + 0.6j, 1j


@contextmanager
def turtlebot3(wire: Wire) -> Iterator[tuple[TurtleBot3, zenoh.Session]]:
    """A robot, and a bare client of its router."""
    endpoint = free_endpoint()
    with TurtleBot3(wire, endpoint, START, HEADING) as robot:
        config = zenoh.Config.from_json5(
            f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}},'
            " scouting: {multicast: {enabled: false}}}"
        )
        with zenoh.open(config) as client:
            yield robot, client


def naming(wire: Wire) -> Naming:
    """What the code under test makes of such a robot."""
    keys = f'ros = "{wire.ros}"\ndomain = {wire.domain}\nnamespace = "{wire.namespace}"\n'
    return Naming.of(parse(edited(PAIR, "robot", f'{keys}cmd_vel = "{wire.cmd_vel}"')).robots, ["robot1"])


@pytest.mark.parametrize(("ros", "kind"), VARIANTS)
def test_a_played_robot_and_our_names_agree_to_the_byte(ros: str, kind: str) -> None:
    wire = Wire(ros, kind, domain=7, namespace="lab/burger")
    ours = naming(wire)
    with turtlebot3(wire) as (robot, client):
        received = client.declare_subscriber(ours.key(ODOM, "robot1"), zenoh.handlers.FifoChannel(100))
        sample = received.recv()
        payload = bytes(sample.payload)
        assert (len(payload), payload[:4]) == (724, b"\0\1\0\0")
        first = decode(Odometry, payload)
        assert (first.frame, first.child_frame) == ("odom", "base_footprint")
        assert abs(first.position) < 1e-3
        assert abs(first.heading - 1.0) < 0.02
        assert (sample.attachment is not None) == (ros == "rmw_zenoh")
        message = encode(Twist(0.1, 0.5) if kind == "twist" else TwistStamped(time.time(), 0.1, 0.5))
        client.put(
            ours.key(CMD_VEL, "robot1"), message, attachment=ours.attachment("robot1/cmd_vel", 1, time.time())
        )
        until(lambda: len(robot.taken) == 1)
        assert robot.taken[0].commanded == (0.1, 0.5)
        until(lambda: len(robot.path) > 20)
        assert robot.moving == pytest.approx((0.1, 0.5), abs=1e-2)
        samples = [decode(Odometry, bytes(received.recv().payload)) for _ in range(20)]
        period = (samples[-1].stamp - samples[0].stamp) / 19
        assert period == pytest.approx(0.05, abs=0.005)
        assert samples[-1].turn_rate == pytest.approx(0.5, abs=0.02)
        assert not robot.troubles


def test_played_robot_limits_commands_and_keeps_the_last() -> None:
    with turtlebot3(Wire()) as (robot, client):
        commanded = [(0.0499, -0.0199), (0.5, -9.0), (-0.22, 0.009)]
        for command in commanded:
            client.put("robot1/cmd_vel", encode(Twist(*command)))
        until(lambda: len(robot.taken) == 3)
        assert [one.obeyed for one in robot.taken] == [(0.04, -0.01), (0.2108, -2.635), (-0.2108, 0.0)]
        time.sleep(1.0)
        assert robot.moving == pytest.approx((-0.2108, 0.0), abs=1e-3)


def test_bridge_misreads_wrong_type_and_breaks_on_empty() -> None:
    with turtlebot3(Wire()) as (robot, client):
        client.put("robot1/cmd_vel", encode(TwistStamped(time.time(), 0.1, 0.5)))
        until(lambda: len(robot.taken) == 1)
        assert robot.taken[0].commanded != (0.1, 0.5)
        assert robot.troubles == {"bytes of another type": 1}
        client.put("robot1/cmd_vel", b"")
        client.put("robot1/cmd_vel", encode(Twist(0.1, 0.0)))
        until(lambda: robot.troubles["no CDR header"] == 1)
        time.sleep(0.2)
        assert len(robot.taken) == 1


def test_rmw_zenoh_needs_a_valid_attachment() -> None:
    wire = Wire("rmw_zenoh")
    ours = naming(wire)
    key = ours.key(CMD_VEL, "robot1")
    with turtlebot3(wire) as (robot, client):
        client.put(key, encode(Twist(0.1, 0.0)))
        client.put(key, encode(Twist(0.2, 0.0)), attachment=ours.attachment("robot1/cmd_vel", 1, 0.0))
        until(lambda: len(robot.taken) == 1)
        assert robot.taken[0].commanded == (0.2, 0.0)
        client.put(key, encode(Twist(0.1, 0.0)), attachment=struct.pack("<qq", 1, 2))
        client.put(key, encode(Twist(0.1, 0.0)), attachment=ours.attachment("robot1/cmd_vel", 2, 0.0))
        until(lambda: robot.troubles["an attachment that ends the node"] == 1)
        time.sleep(0.2)
        assert len(robot.taken) == 1
        assert robot.troubles["no attachment"] == 1


def test_after_a_reset_odometry_counts_from_where_the_robot_is() -> None:
    with turtlebot3(Wire()) as (robot, client):
        received = client.declare_subscriber("robot1/odom", zenoh.handlers.RingChannel(1))
        client.put("robot1/cmd_vel", encode(Twist(0.2, 1.0)))
        until(lambda: abs(robot.now.position - START) > 0.1)
        client.put("robot1/cmd_vel", encode(Twist(0.0, 0.0)))
        until(lambda: len(robot.taken) == 2 and abs(robot.moving.speed) < 1e-4)
        before = decode(Odometry, bytes(received.recv().payload))
        truth = robot.now
        assert (truth.position - START) * (-1j) == pytest.approx(before.position, abs=2e-3)
        robot.reset_odometry()
        received.recv()
        after = decode(Odometry, bytes(received.recv().payload))
        assert abs(after.position) < 2e-3
        assert abs(after.heading - 1.0) < 0.02


def test_what_a_played_robot_shows_of_itself_is_read() -> None:
    with turtlebot3(Wire("rmw_zenoh", "twist_stamped", 3)) as (robot, _):
        found = [tokens.read(key) for key in robot.graph()]
    shown = sorted((one.kind, one.topic, one.type) for one in found if one)
    assert shown == [
        ("MP", "robot1/odom", "nav_msgs/msg/Odometry"),
        ("MS", "robot1/cmd_vel", "geometry_msgs/msg/TwistStamped"),
        ("NN", "", ""),
    ]
    with turtlebot3(Wire()) as (_, client):
        replies = client.liveliness().get(tokens.ROUTES, timeout=5.0)
        routes = [tokens.read_route(str(reply.ok.key_expr)) for reply in replies if reply.ok is not None]
    assert sorted((one.kind, one.key, one.type) for one in routes if one) == [
        ("MP", "robot1/odom", "nav_msgs/msg/Odometry"),
        ("MS", "robot1/cmd_vel", "geometry_msgs/msg/Twist"),
    ]
