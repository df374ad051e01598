"""The topic table: every key on the wire, who sends it to whom, and how. No key is spelled anywhere else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

Priority = Literal["real_time", "data", "background"]
Side = Literal["robot", "fleet"]


@dataclass(frozen=True, slots=True)
class Qos:
    """How a topic travels. Congestion always drops: a late state is worth less than the next one."""

    priority: Priority = "data"
    express: bool = False
    """Send at once instead of batching with whatever else is due."""

    def __str__(self) -> str:
        return ", ".join(["drop", self.priority.replace("_", "-")] + ["express"] * self.express)


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table."""

    name: str
    pattern: str
    """Key with ``{robot}`` and ``{other}`` where a robot's name goes."""
    type: str
    """ROS 2 type of the payload, ``package/msg/Name``; empty for a queryable, which carries JSON."""
    sender: str
    receiver: str
    rate: str
    """For people; the numbers are the mission's."""
    qos: Qos | None
    """None for a queryable."""
    purpose: str
    side: Side = "fleet"
    """Between an agent and its own robot, on the robot itself; or between robots, and to whoever watches."""
    alternative: str = ""
    """Second type some robots use on the same key."""

    def key(self, robot: str = "", other: str = "") -> str:
        """The key for `robot` (and the `other` robot it is about). ValueError for a name missing or unfit."""
        for field, name in (("robot", robot), ("other", other)):
            if ("{" + field + "}" in self.pattern) != bool(name):
                raise ValueError(f"topic {self.name!r} has the key {self.pattern!r}: {field} is {name!r}")
            if any(c in "/*$?#{}" or c.isspace() for c in name):
                raise ValueError(
                    f"{field} {name!r} cannot be part of a key: no spaces and none of / * $ ? # {{ }}"
                )
        return self.pattern.format(robot=robot, other=other)

    @property
    def types(self) -> tuple[str, ...]:
        """Every ROS 2 type that may stand on this key."""
        return tuple(t for t in (self.type, self.alternative) if t)


REAL_TIME = Qos("real_time")
BACKGROUND = Qos("background")

ODOM = Topic(
    "odom", "{robot}/odom", "nav_msgs/msg/Odometry", "robot", "its agent", "20-50 Hz", REAL_TIME,
    "the robot's own position and speed", "robot",
)  # fmt: skip
CMD_VEL = Topic(
    "cmd_vel", "{robot}/cmd_vel", "geometry_msgs/msg/Twist", "agent", "its robot", "each odom",
    Qos("real_time", express=True), "forward speed and turn rate", "robot",
    alternative="geometry_msgs/msg/TwistStamped",
)  # fmt: skip
POSITION = Topic(
    "position", "{robot}/position", "geometry_msgs/msg/PoseStamped", "agent or leader",
    "robots that measure or mind it", "each odom", Qos("data", express=True),
    "centre and estimated heading in the world frame; the order rides as attachment",
)  # fmt: skip
SCAN = Topic(
    "scan", "{robot}/scan", "sensor_msgs/msg/LaserScan", "robot", "its agent (optional)", "5 Hz", Qos(),
    "range scan", "robot",
)  # fmt: skip
RELATIVE = Topic(
    "relative", "{robot}/relative/{other}", "geometry_msgs/msg/PointStamped", "sensor on the robot",
    "its agent (optional)", "sensor", REAL_TIME,  # as odometry, which would else overtake it
    "locally measured displacement to the other's control point, body frame", "robot",
)  # fmt: skip
POSE = Topic(
    "pose", "{robot}/pose", "geometry_msgs/msg/PoseStamped", "localisation", "its agent (optional)", "sensor",
    REAL_TIME, "centre and heading in the world frame, from an overhead camera or motion capture", "robot",
)  # fmt: skip
ALIVE = Topic(
    "alive", "{robot}/alive", "std_msgs/msg/Float64", "agent", "its guard, a second agent", "each command",
    Qos("real_time", express=True), "time since the agent's start, said with each command [s]", "robot",
)  # fmt: skip
GUARD = Topic(
    "guard", "{robot}/guard", "", "doctor", "a robot's guard (queryable)", "on demand", None,
    "whether the guard itself is there, and what it is doing (JSON)", "robot",
)  # fmt: skip
STATUS = Topic(
    "status", "{robot}/status", "diagnostic_msgs/msg/DiagnosticArray", "agent or leader", "monitor", "2 Hz",
    BACKGROUND, "state, reason and counters",
)  # fmt: skip
GROUND_TRUTH = Topic(
    "ground_truth", "{robot}/ground_truth", "geometry_msgs/msg/PoseStamped", "simulated robot", "monitor",
    "as odom", BACKGROUND, "where the simulated robot really is", "robot",
)  # fmt: skip
ERROR = Topic(
    "error", "formation/error", "std_msgs/msg/Float64", "monitor", "anyone", "10 Hz", BACKGROUND,
    "formation error, summed over the edges [m]",
)  # fmt: skip
DIAGNOSTICS = Topic(
    "diagnostics", "formation/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "monitor", "anyone",
    "1 Hz", BACKGROUND, "errors per edge, rates, losses and ages per robot",
)  # fmt: skip
EVENTS = Topic(
    "events", "formation/events", "rcl_interfaces/msg/Log", "monitor", "anyone", "as they happen", BACKGROUND,
    "robots joined, lost, held or stopped, orders given, messages rejected",
)  # fmt: skip
ORDER = Topic(
    "order", "{robot}/order", "", "operator", "agent or leader (queryable)", "on demand", None,
    "hold, run, stop, release, another figure, course or gains, acknowledged one by one (JSON)",
)  # fmt: skip

BALLOT = Topic(
    "ballot", "{robot}/ballot", "std_msgs/msg/String", "leader or standby", "agents and other standbys",
    "10-20 Hz, with standbys", Qos("data", express=True),
    "asks for the followers' voices in a term, and keeps them (JSON); they answer with their positions",
)  # fmt: skip
COURSE = Topic(
    "course", "{robot}/course", "std_msgs/msg/String", "who leads", "standbys", "1 Hz, with standbys", Qos(),
    "the route that the leader is on, for whoever takes its place (JSON)",
)  # fmt: skip

TABLE: tuple[Topic, ...] = (
    ODOM, CMD_VEL, POSITION, SCAN, RELATIVE, POSE, ALIVE, STATUS, GROUND_TRUTH, ERROR, DIAGNOSTICS, EVENTS,
    BALLOT, COURSE, ORDER, GUARD,
)  # fmt: skip


def command_topic(kind: Literal["twist", "twist_stamped"]) -> Topic:
    """`CMD_VEL` with the type that a robot of this `kind` takes."""
    if kind == "twist":
        return CMD_VEL
    return replace(CMD_VEL, type=CMD_VEL.alternative, alternative="")


def markdown() -> str:
    """The table as it stands in the README."""

    def rows() -> Iterator[str]:
        yield "| key | message | from → to | rate | QoS | what |"
        yield "|---|---|---|---|---|---|"
        for t in TABLE:
            key = t.pattern.replace("{", "<").replace("}", ">")
            message = " or ".join(name.replace("/msg/", "/") for name in t.types) or "JSON"
            qos = str(t.qos) if t.qos else "queryable"
            yield f"| `{key}` | {message} | {t.sender} → {t.receiver} | {t.rate} | {qos} | {t.purpose} |"

    return "\n".join(rows()) + "\n"
