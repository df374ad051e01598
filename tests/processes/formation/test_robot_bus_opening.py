"""A robot's bus with a session that opens, but then fails to declare its keys."""

from __future__ import annotations

import threading
from collections import Counter
from typing import Any, ClassVar

import pytest

from formation.mission.file import load
from formation.ros2.naming import Naming
from formation.topics import CMD_VEL, command_topic
from formation.transport import robot_bus
from formation.transport.bus_config import BusError
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from tests.support.child import PATIENCE, until

PAIR = load("turtlebot3_pair")


class Session:
    """A fake session; the first two that are opened fail to advertise."""

    failure: ClassVar[Exception]
    ready: ClassVar[threading.Event]
    opened: ClassVar[list[Session]]
    zid, linked_routers = "0", 1

    def __init__(self, *_: Any) -> None:
        assert self.ready.wait(PATIENCE)
        self.closed, self.received = False, Counter[str]()
        self.opened.append(self)

    def advertise(self, *_: Any) -> None:
        if len(self.opened) <= 2:
            raise self.failure

    def claim(self, *_: Any) -> None:
        pass

    def close(self) -> None:
        self.closed = True


@pytest.mark.parametrize("failure", [BusError("cannot declare"), RuntimeError("unexpected")])
def test_session_that_fails_to_declare_is_reopened(
    monkeypatch: pytest.MonkeyPatch, failure: Exception
) -> None:
    monkeypatch.setattr(robot_bus, "Bus", Session)
    monkeypatch.setattr(robot_bus, "REDIAL_PERIOD", 0.01)
    Session.failure, Session.ready, Session.opened = failure, threading.Event(), []
    with RobotBus(("tcp/127.0.0.1:1",), Naming.of(PAIR.robots, ["robot1"]), Mailbox()) as bus:
        bus.advertise(command_topic("twist_stamped"), CMD_VEL.key("robot1"))
        Session.ready.set()
        until(lambda: bus.connected)
    assert [session.closed for session in Session.opened] == [True] * 3
