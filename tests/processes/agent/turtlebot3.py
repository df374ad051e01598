"""A TurtleBot3 Burger, played on its own Zenoh router: it sends what ROS 2 on the robot would send.

Of the code under test it uses only the physics, `formation.agent.simulated.plant`: keys, hashes,
attachments and tokens are written out again, messages are encoded and hashed by rosbags, which the product
may not import, and the session is bare. It follows the published sources:

- 20 Hz odometry, relative to the pose at which the robot was switched on or `reset_odometry` was called;
- commands truncated to hundredths by a cast to integer, clamped by the firmware, and obeyed until the next;
- a bridge accepts any bytes as the type it expects, but a payload that is empty or has no CDR header ends
  its route permanently; rmw_zenoh drops a sample without attachment, and its node dies of an attachment
  that it cannot read.
"""

from __future__ import annotations

import math
import struct
import threading
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import zenoh
from rosbags.serde import SerdeError

from formation.agent.simulated.plant import Plant
from formation.control.unicycle import Command
from formation.simulation.body import PROFILES
from tests.unit.formation.by_rosbags import STORE, ZEROS, header, make, point, twist

PERIOD = 0.05
"""Period of odometry [s]."""
CLAMPS = (0.2108, 2.635)
"""Limits of the firmware [m/s], [rad/s]."""
BODY = PROFILES["turtlebot3_burger"]._replace(
    speed_step=0.0, turn_rate_step=0.0, max_speed=math.inf, max_turn_rate=math.inf,  # applied in this file
    drift=0.0,  # no controller can measure it; without it, true poses can be compared
)  # fmt: skip


@dataclass(frozen=True)
class Wire:
    """How a robot's ROS 2 reaches Zenoh, and the type of its cmd_vel."""

    ros: str = "ros2dds"
    cmd_vel: str = "twist"
    domain: int = 0
    namespace: str = "robot1"

    @property
    def command_type(self) -> str:
        """ROS type of its cmd_vel."""
        return {"twist": "geometry_msgs/msg/Twist", "twist_stamped": "geometry_msgs/msg/TwistStamped"}[
            self.cmd_vel
        ]

    def name(self, topic: str) -> str:
        """ROS name of a topic, without its leading slash."""
        return f"{self.namespace}/{topic}" if self.namespace else topic

    def key(self, topic: str, ros_type: str) -> str:
        """Zenoh key of a topic."""
        if self.ros == "ros2dds":
            return self.name(topic)
        return f"{self.domain}/{self.name(topic)}/{dds(ros_type)}/{STORE.hash_rihs01(ros_type)}"

    def tokens(self, zid: str) -> list[str]:
        """Liveliness tokens of the robot's odometry publisher and command subscriber."""
        has = [("MP", "odom", "nav_msgs/msg/Odometry"), ("MS", "cmd_vel", self.command_type)]
        if self.ros == "ros2dds":
            return [
                f"@/{zid}/@ros2_lv/{kind}/{self.name(topic).replace('/', '§')}/"
                f"{ros_type.replace('/', '§')}/:1:0:0,10"
                for kind, topic, ros_type in has
            ]
        node = f"%/%{self.namespace.replace('/', '%')}/turtlebot3_node"
        return [f"@ros2_lv/{self.domain}/{zid}/0/0/NN/{node}"] + [
            f"@ros2_lv/{self.domain}/{zid}/0/{number}/{kind}/{node}/%{self.name(topic).replace('/', '%')}/"
            f"{dds(ros_type)}/{STORE.hash_rihs01(ros_type)}/::,10:,:,:,,"
            for number, (kind, topic, ros_type) in enumerate(has, 1)
        ]


class Moment(NamedTuple):
    """True pose of the robot at a time."""

    wall: float
    position: complex
    heading: complex


class Taken(NamedTuple):
    """A command that reached the wheels, as it was sent and as the firmware applied it."""

    mono: float
    commanded: Command
    obeyed: Command


class TurtleBot3:
    """A robot that is switched on at the start of the `with` block, at rest."""

    def __init__(
        self, wire: Wire, endpoint: str, position: complex, heading: complex, *, prefixed: bool = False
    ) -> None:
        """At `position` [m; world frame] with unit `heading`; its router listens on `endpoint`.

        `prefixed`: its bring-up knows the namespace, which then also prefixes both frames.
        """
        self.wire = wire
        self.endpoint = endpoint
        self.path: list[Moment] = []
        """True poses, one for each odometry."""
        self.taken: list[Taken] = []
        self.troubles: Counter[str] = Counter()
        """Counts of invalid messages, which no agent may send."""
        self.lost = 0
        """Number of missing samples, by the sequence numbers in attachments."""
        prefix = f"{wire.namespace}/" if prefixed else ""
        self._frames = (f"{prefix}odom", f"{prefix}base_footprint")
        self._plant = Plant(BODY, position, heading, np.random.default_rng(1))
        self._origin = (position, heading)
        self._alive = True  # False when the route is lost or the node is dead
        self._sequences: dict[bytes, int] = {}
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._timer = threading.Thread(target=self._run, name="turtlebot3")

    def __enter__(self) -> Self:
        config = zenoh.Config.from_json5(
            f'{{mode: "router", listen: {{endpoints: ["{self.endpoint}"]}},'
            " scouting: {multicast: {enabled: false}, gossip: {enabled: false}}}"
        )
        self.session = zenoh.open(config)
        zid = str(self.session.info.zid())
        self._gid = zid.encode().ljust(16, b"0")[:16]
        self._odometry = self.session.declare_publisher(self.wire.key("odom", "nav_msgs/msg/Odometry"))
        self._commands = self.listen()
        self._tokens = [self.session.liveliness().declare_token(key) for key in self.wire.tokens(zid)]
        self._time = time.monotonic()
        self._timer.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._timer.join()
        self.session.close()  # type: ignore[no-untyped-call]

    @property
    def now(self) -> Moment:
        """True pose now."""
        with self._lock:
            self._advance()
            return Moment(time.time(), self._plant.position, self._plant.heading)

    @property
    def moving(self) -> Command:
        """True speed and turn rate."""
        with self._lock:
            self._advance()
            return self._plant.moving

    @property
    def has_listener(self) -> bool:
        """Whether a process subscribes to its odometry; if none does, all that they sent has arrived."""
        return bool(self._odometry.matching_status.matching)  # type: ignore[attr-defined]

    def reset_odometry(self) -> int:
        """Start odometry at zero from the current pose, as the ROS service of that name does.

        Returns the number of commands taken before.
        """
        with self._lock:
            self._advance()
            self._origin = (self._plant.position, self._plant.heading)
            return len(self.taken)

    def lose_route(self) -> None:
        """Drop the route of cmd_vel, as a bridge does after a node of that name crashed and restarted."""
        self._commands.undeclare()  # type: ignore[no-untyped-call]

    def listen(self) -> zenoh.Subscriber[None]:
        """Subscribe to commands."""
        key = self.wire.key("cmd_vel", self.wire.command_type)
        return self.session.declare_subscriber(key, zenoh.handlers.Callback(self._take, indirect=False))

    def graph(self) -> list[str]:
        """Return every token of rmw_zenoh that this robot's ROS 2 sees, including its own."""
        replies = self.session.liveliness().get(f"@ros2_lv/{self.wire.domain}/**", timeout=5.0)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def _run(self) -> None:
        due = self._time
        sequence = 0
        before = self.now
        while not self._over.wait(due - time.monotonic()):
            due += PERIOD
            sequence += 1
            before = self._publish_odometry(sequence, before)

    def _publish_odometry(self, sequence: int, before: Moment) -> Moment:
        """Publish one odometry, with the speed since the one `before`."""
        with self._lock:
            self._advance()
            wall = time.time()
            here = Moment(wall, self._plant.position, self._plant.heading)
            position, heading = self._plant.odometry()
            origin, zero = self._origin
        elapsed, turned = wall - before.wall, here.heading * before.heading.conjugate()
        way = (here.position - before.position) * (before.heading * turned**0.5).conjugate()
        moving = way.real / elapsed, math.atan2(turned.imag, turned.real) / elapsed
        seen = (position - origin) * zero.conjugate(), heading * zero.conjugate()
        payload = odometry(wall, *seen, moving, self._frames)
        attachment = struct.pack("<qqB16s", sequence, int(wall * 1e9), 16, self._gid)
        self._odometry.put(payload, attachment=None if self.wire.ros == "ros2dds" else attachment)
        self.path.append(here)
        return here

    def _take(self, sample: zenoh.Sample) -> None:
        with self._lock:
            self._advance()
            commanded = self._decoded(sample) if self._alive else None
            if commanded is None:
                return
            obeyed = Command(*(
                max(-clamp, min(clamp, hundredths(value) / 100.0))
                for value, clamp in zip(commanded, CLAMPS, strict=True)
            ))  # fmt: skip
            self._plant.obey(obeyed)
            self.taken.append(Taken(self._time, commanded, obeyed))

    def _decoded(self, sample: zenoh.Sample) -> Command | None:
        """Decode the command in `sample` as the robot's ROS 2 does; None if it does not reach the node."""
        payload = bytes(sample.payload)
        if self.wire.ros == "rmw_zenoh" and not self._attached(sample):
            return None
        if len(payload) <= 4 or payload[0] or payload[1] > 1:
            self.troubles["no CDR header"] += 1
            self._alive = self.wire.ros == "rmw_zenoh"
            return None
        try:
            message = STORE.deserialize_cdr(payload, self.wire.command_type)
        except SerdeError:
            self.troubles["no message of its type"] += 1
            return None
        if bytes(STORE.serialize_cdr(message, self.wire.command_type)) != payload:
            self.troubles["bytes of another type"] += 1  # but obeyed
        found: Any = getattr(message, "twist", message)
        return Command(found.linear.x, found.angular.z)

    def _attached(self, sample: zenoh.Sample) -> bool:
        if sample.attachment is None:
            self.troubles["no attachment"] += 1
            return False
        attachment = bytes(sample.attachment)
        if len(attachment) != 33 or attachment[16] != 16:
            self.troubles["an attachment that ends the node"] += 1
            self._alive = False
            return False
        sequence, gid = struct.unpack_from("<q", attachment)[0], attachment[17:]
        self.lost += abs(sequence - self._sequences.get(gid, sequence - 1)) - 1
        self._sequences[gid] = sequence
        return True

    def _advance(self) -> None:
        now = time.monotonic()
        self._plant.advance(now - self._time)
        self._time = now


def hundredths(value: float) -> int:
    """Return ``static_cast<int32_t>(value * 100)`` as ARM does: truncated, saturated if out of range."""
    return 0 if math.isnan(value) else int(max(-(2.0**31), min(2.0**31 - 1, value * 100)))


def dds(ros_type: str) -> str:
    """The DDS name of a ROS message type."""
    return "{}::{}::dds_::{}_".format(*ros_type.split("/"))


def odometry(
    wall: float, position: complex, heading: complex, moving: tuple[float, float], frames: tuple[str, str]
) -> bytes:
    """nav_msgs/Odometry with zero covariances in CDR; `heading` e^{iθ}, `moving` [m/s; rad/s]."""
    half = math.atan2(heading.imag, heading.real) / 2.0
    turn = make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(half), math.cos(half))
    pose = make("geometry_msgs/msg/Pose", point(position), turn)
    raw = make(
        "nav_msgs/msg/Odometry", header(wall, frames[0]), frames[1],
        make("geometry_msgs/msg/PoseWithCovariance", pose, ZEROS),
        make("geometry_msgs/msg/TwistWithCovariance", twist(*moving), ZEROS),
    )  # fmt: skip
    return bytes(STORE.serialize_cdr(raw, "nav_msgs/msg/Odometry"))
