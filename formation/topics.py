"""The topic table: every key on the wire, its publishers, subscribers and QoS. All keys are defined here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

Priority = Literal["real_time", "data", "background"]
Side = Literal["robot", "fleet"]
Role = Literal["follower", "leader", "standby"]


@dataclass(frozen=True, slots=True)
class Qos:
    """QoS of a topic. Congestion always drops: a late state is worth less than the next one."""

    priority: Priority = "data"
    express: bool = False
    """Send at once instead of batching with other messages."""

    def __str__(self) -> str:
        return ", ".join(["drop", self.priority.replace("_", "-")] + ["express"] * self.express)


@dataclass(frozen=True, slots=True)
class Topic:
    """One row of the table."""

    name: str
    pattern: str
    """Key with ``{robot}`` and ``{other}`` in place of a robot's name."""
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
    """Between an agent and its own robot, on the robot itself; or between robots, and to monitors."""
    alternative: str = ""
    """Second type some robots use on the same key."""
    agent_input: bool = False
    """Whether an agent reads it, so that a recording must have it to run the agent again."""
    sensor_data: bool = False
    """Whether ROS 2 declares it with the QoS of sensor data: best effort, the last 5 kept."""
    monitored: tuple[Role, ...] = ()
    """Roles of which the monitor subscribes to this key, `{other}` aside."""
    promised_rate: Literal["robot"] | float | None = None
    """That of the robot's mission entry, or this one [Hz]; None for a sensor's own or none."""

    def key(self, robot: str = "", other: str = "") -> str:
        """The key for `robot` (and the `other` robot). ValueError for a missing or invalid name."""
        return _key(self.name, self.pattern, robot, other)

    @property
    def from_robot(self) -> bool:
        """Whether an agent receives it from its own robot."""
        return self.side == "robot" and self.agent_input

    @property
    def types(self) -> tuple[str, ...]:
        """Every ROS 2 type that is allowed on this key."""
        return tuple(t for t in (self.type, self.alternative) if t)


@lru_cache(maxsize=4096)
def _key(topic: str, pattern: str, robot: str, other: str) -> str:
    for field, name in (("robot", robot), ("other", other)):
        if ("{" + field + "}" in pattern) != bool(name):
            raise ValueError(f"topic {topic!r} has the key {pattern!r}: {field} is {name!r}")
        if any(c in "/*$?#{}" or c.isspace() for c in name):
            raise ValueError(
                f"{field} {name!r} cannot be part of a key: no spaces and none of / * $ ? # {{ }}"
            )
    return pattern.format(robot=robot, other=other)


REAL_TIME = Qos("real_time")
BACKGROUND = Qos("background")

ODOM = Topic(
    "odom", "{robot}/odom", "nav_msgs/msg/Odometry", "robot", "its agent", "20-50 Hz", REAL_TIME,
    "the robot's own position and speed", "robot",
    agent_input=True, monitored=("follower",), promised_rate="robot",
)  # fmt: skip
CMD_VEL = Topic(
    "cmd_vel", "{robot}/cmd_vel", "geometry_msgs/msg/Twist", "agent", "its robot", "each odom",
    Qos("real_time", express=True), "forward speed and turn rate", "robot",
    alternative="geometry_msgs/msg/TwistStamped", monitored=("follower",), promised_rate="robot",
)  # fmt: skip
POSITION = Topic(
    "position", "{robot}/position", "geometry_msgs/msg/PoseStamped", "agent or leader",
    "robots that measure or avoid it", "each odom", Qos("data", express=True),
    "centre and estimated heading in the world frame; the order is attached",
    agent_input=True, monitored=("follower", "leader"), promised_rate="robot",
)  # fmt: skip
SCAN = Topic(
    "scan", "{robot}/scan", "sensor_msgs/msg/LaserScan", "robot", "its agent (optional)", "5 Hz", Qos(),
    "range scan", "robot", agent_input=True, sensor_data=True, monitored=("follower",),
)  # fmt: skip
RELATIVE = Topic(
    "relative", "{robot}/relative/{other}", "geometry_msgs/msg/PointStamped", "sensor on the robot",
    "its agent (optional)", "sensor", REAL_TIME,  # as odometry, which would otherwise overtake it
    "displacement from the robot's control point to the other's, body frame", "robot", agent_input=True,
)  # fmt: skip
POSE = Topic(
    "pose", "{robot}/pose", "geometry_msgs/msg/PoseStamped", "localisation", "its agent (optional)", "sensor",
    REAL_TIME, "centre and heading in the world frame, from a camera or motion capture", "robot",
    agent_input=True, monitored=("follower",),
)  # fmt: skip
AMCL_POSE = Topic(
    "amcl_pose", "{robot}/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", "localiser",
    "its agent (optional)", "as the robot moves", REAL_TIME, "pose in the map, as AMCL publishes it", "robot",
    agent_input=True, monitored=("follower",),
)  # fmt: skip
TF = Topic(
    "tf", "{robot}/tf", "tf2_msgs/msg/TFMessage", "localiser and others", "its agent (optional)", "sensor",
    Qos(), "transforms, of which the agent uses that from the map to its odometry's frame", "robot",
    agent_input=True, monitored=("follower",),
)  # fmt: skip
ALIVE = Topic(
    "alive", "{robot}/alive", "std_msgs/msg/Float64", "agent", "its watchdog, a second agent", "each command",
    Qos("real_time", express=True), "time since the agent's start, published with each command [s]", "robot",
)  # fmt: skip
WATCHDOG = Topic(
    "watchdog", "{robot}/watchdog", "", "doctor", "a robot's watchdog (queryable)", "on demand", None,
    "whether the watchdog itself is there, and what it is doing (JSON)", "robot",
)  # fmt: skip
STATUS = Topic(
    "status", "{robot}/status", "diagnostic_msgs/msg/DiagnosticArray", "agent or leader", "monitor", "2 Hz",
    BACKGROUND, "state, reason and counters", monitored=("follower", "leader", "standby"), promised_rate=2.0,
)  # fmt: skip
GROUND_TRUTH = Topic(
    "ground_truth", "{robot}/ground_truth", "geometry_msgs/msg/PoseStamped", "simulated robot", "monitor",
    "as odom", BACKGROUND, "where the simulated robot really is", "robot",
    monitored=("follower",), promised_rate="robot",
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
    "hold, run, stop, release, another shape, route or gains, acknowledged one by one (JSON)",
)  # fmt: skip

BALLOT = Topic(
    "ballot", "{robot}/ballot", "std_msgs/msg/String", "leader or standby", "agents and other standbys",
    "10-20 Hz, with standbys", Qos("data", express=True),
    "asks for the followers' votes in a term, and keeps them (JSON); they answer with their positions",
    agent_input=True, monitored=("leader", "standby"),
)  # fmt: skip
ROUTE = Topic(
    "route", "{robot}/route", "std_msgs/msg/String", "leader", "standbys", "1 Hz, with standbys", Qos(),
    "the route that the leader is on, for the standby that takes its place (JSON)",
    monitored=("leader", "standby"),
)  # fmt: skip

TABLE: tuple[Topic, ...] = (
    ODOM, CMD_VEL, POSITION, SCAN, RELATIVE, POSE, AMCL_POSE, TF, ALIVE, STATUS, GROUND_TRUTH, ERROR,
    DIAGNOSTICS, EVENTS, BALLOT, ROUTE, ORDER, WATCHDOG,
)  # fmt: skip


def command_topic(kind: Literal["twist", "twist_stamped"]) -> Topic:
    """`CMD_VEL` with the type that a robot of this `kind` takes."""
    if kind == "twist":
        return CMD_VEL
    return replace(CMD_VEL, type=CMD_VEL.alternative, alternative="")


def action_statuses(action: str) -> str:
    """Key on which ROS publishes how far an action is with its goals; no topic of formation."""
    return f"{action.strip('/')}/_action/status"


def action_feedback(action: str) -> str:
    """Key on which ROS publishes how an action gets on with one goal; no topic of formation."""
    return f"{action.strip('/')}/_action/feedback"
