"""Helpers for tests of the robot's bus: missions for each ROS 2 transport, ROS nodes as bare sessions."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

from formation.mission.file import parse, read
from formation.mission.model import Mission
from formation.ros2.messages import Odometry, Twist, encode
from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from formation.topics import ALIVE, CMD_VEL, ODOM, POSITION
from formation.transport.bus_config import DEFAULTS
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus

COMMAND, ODOM_KEY, PLACE, LIFE = (topic.key("robot2") for topic in (CMD_VEL, ODOM, POSITION, ALIVE))
TWIST, ODOMETRY = encode(Twist(0.1, 0.0)), encode(Odometry(1.0, 2.0 + 1.0j, 1.0 + 0.0j, 0.1, 0.0))


def mission_of(*transports: Ros, lines: str = "") -> Mission:
    """Return six_robots; the first followers have these ROS 2 transports, the first one more `lines`."""
    text, source = read("six_robots")
    for number, ros in enumerate(transports):
        table = f"[robots.robot{number + 2}]\n"
        assert table in text
        more = f"{lines}\n" if number == 0 else ""
        text = text.replace(table, f'{table}ros = "{ros}"\n{more}')
    return parse(text, source)


@contextmanager
def node(endpoint: str, mode: str = "peer") -> Iterator[zenoh.Session]:
    """Open a session as an ordinary ROS 2 node has it: a peer with gossip that dials its router."""
    config = zenoh.Config()
    for path, value in DEFAULTS:
        config.insert_json5(path, value)
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/gossip/enabled", "true")
    config.insert_json5("listen/endpoints", json.dumps(["tcp/127.0.0.1:0"] if mode == "peer" else []))
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        yield session


class Listener:
    """Records every sample that a bare session receives on a key."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.samples: list[tuple[bytes, bytes | None]] = []
        self._subscriber = session.declare_subscriber(
            key, zenoh.handlers.Callback(self._record, indirect=False)
        )

    def _record(self, sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        self.samples.append(
            (sample.payload.to_bytes(), None if attachment is None else attachment.to_bytes())
        )

    @property
    def payloads(self) -> list[bytes]:
        return [payload for payload, _ in self.samples]


def tokens(session: zenoh.Session) -> set[str]:
    """Return every liveliness token that `session` can see."""
    replies: Any = session.liveliness().get("@ros2_lv/**", timeout=5.0)
    return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}


def agent_on(endpoint: str, naming: Naming, mailbox: Mailbox | None = None) -> RobotBus:
    """Open an agent's bus: it publishes commands and receives odometry."""
    bus = RobotBus((endpoint,), naming, mailbox or Mailbox())
    bus.advertise(CMD_VEL, COMMAND)
    bus.subscribe(ODOM, ODOM_KEY)
    return bus


def robot_on(endpoint: str, naming: Naming) -> tuple[RobotBus, Mailbox]:
    """Open a robot's bus, which is the router: it receives commands and publishes odometry."""
    mailbox = Mailbox()
    bus = RobotBus((endpoint,), naming, mailbox, mode="router", node="robot")
    bus.subscribe(CMD_VEL, COMMAND)
    bus.advertise(ODOM, ODOM_KEY)
    return bus, mailbox
