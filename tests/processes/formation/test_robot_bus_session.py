"""A session of the robot's bus: its links, how it closes, and what it refuses."""

from __future__ import annotations

import os
import time
from contextlib import ExitStack

import psutil
import pytest

from formation.ros2.naming import Naming
from formation.topics import ODOM, ORDER, STATUS
from formation.transport.bus import BusError
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from tests.processes.agent.robot_sides import COMMAND, ODOM_KEY, TWIST, agent_on, robot_on
from tests.support.child import until
from tests.support.zenoh_admin import clients, inspect

pytestmark = pytest.mark.processes


def test_close_sends_last_message_and_ends_session(endpoint: str, naming: Naming) -> None:
    robot, at_robot = robot_on(endpoint, naming)
    with robot:
        agent = agent_on(endpoint, naming)
        until(lambda: bool(agent.routed(COMMAND)))
        agent.publish(COMMAND, TWIST)
        agent.close()
        agent.close()
        until(lambda: at_robot.received[COMMAND] == 1)
        assert (agent.connected, agent.routed(COMMAND)) == (False, None)
        until(lambda: robot.routed(ODOM_KEY) is False)


@pytest.mark.parametrize("ros", ["rmw_zenoh"])
def test_closing_without_peers_is_quick(endpoint: str, naming: Naming) -> None:
    agent = agent_on(endpoint, naming)
    start = time.monotonic()
    agent.close()
    assert time.monotonic() - start < 1.5
    robot, _ = robot_on(endpoint, naming)
    with robot:
        time.sleep(0.8)
        assert robot.routed(ODOM_KEY) is False  # the closed bus does not link again


def test_client_has_one_link_and_no_multicast(endpoint: str, naming: Naming, stack: ExitStack) -> None:
    robot, _ = robot_on(endpoint, naming)
    stack.enter_context(robot)
    agent = stack.enter_context(agent_on(endpoint, naming))
    until(lambda: bool(agent.routed(COMMAND)))
    router, (client,) = inspect(endpoint), clients(endpoint)
    assert (router.name, router.kinds) == ("robot", frozenset({"client"}))
    assert list(router.links.values()) == [1]
    assert router.subscriptions == {naming.wire(COMMAND)}
    assert (client.name, client.kinds) == ("formation_agent", frozenset({"router"}))
    assert client.links == {router.zid: 1}
    assert client.subscriptions == {naming.wire(ODOM_KEY)}
    assert client.publications == {naming.wire(COMMAND)}
    assert client.locators == ()
    connections = psutil.Process(os.getpid()).net_connections("inet")
    assert not [one for one in connections if one.type.name == "SOCK_DGRAM"]


def test_router_reports_an_occupied_endpoint(endpoint: str, naming: Naming) -> None:
    with (
        RobotBus((endpoint,), naming, Mailbox(), mode="router"),
        pytest.raises(BusError, match=f"cannot listen on {endpoint}: the address is in use"),
    ):
        RobotBus((endpoint,), naming, Mailbox(), mode="router")


def test_unknown_or_foreign_keys_are_refused(endpoint: str, naming: Naming) -> None:
    with RobotBus((endpoint,), naming, Mailbox()) as bus:
        bus.advertise(STATUS, "robot2/status")
        bus.subscribe(ODOM, ODOM_KEY)
        with pytest.raises(BusError, match="'robot2/status' is advertised already"):
            bus.advertise(STATUS, "robot2/status")
        with pytest.raises(BusError, match="'robot2/odom' is subscribed to already"):
            bus.subscribe(ODOM, ODOM_KEY)
        with pytest.raises(BusError, match="'order' is a queryable"):
            bus.advertise(ORDER, "robot2/order")
        with pytest.raises(BusError, match="'robot2/cmd_vel' is not advertised: robot2/status"):
            bus.publish(COMMAND, TWIST)
        with pytest.raises(BusError, match="is not advertised"):
            bus.routed(COMMAND)
        with pytest.raises(KeyError):
            bus.subscribe(ODOM, "robot3/odom")
        with pytest.raises(ValueError, match="no key of the topic table"):
            bus.subscribe(ODOM, "robot2/wheels")
    with pytest.raises(BusError, match="--robot-connect 'tcp/nowhere'"):
        RobotBus(("tcp/nowhere",), naming, Mailbox())
