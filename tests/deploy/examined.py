"""Facts for the doctor: a robot and a desk with which nothing is wrong, and what is found in others."""

from __future__ import annotations

from dataclasses import replace

from deploy.doctor.cli import EXAMINATIONS
from deploy.doctor.facts import Certificate, Chrony, Facts, Heard, Party, Reached, Stream, examine
from formation.mission_file import load
from formation.ros2.messages import Status

TB3 = load("turtlebot3_pair")
WALL = 1.8e9
DAY = 86_400.0
STAMPED, TWIST = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"


def stream(
    rate: float = 20.0, seconds: float = 3.0, behind: float = 0.002, frames: tuple[str, ...] = ("odom",)
) -> Stream:
    times = [k / rate for k in range(int(seconds * rate))]
    heard = tuple(Heard(100.0 + t, WALL + t - behind, WALL + t) for t in times)
    return Stream(heard, frozenset(frames))


def paused(*pauses: float) -> Stream:
    """20 Hz for 3 s, with pauses."""
    at, heard = 0.0, []
    waits = [*pauses, *[0.05] * round((3.0 - sum(pauses)) / 0.05)]
    for wait in waits:
        heard.append(Heard(100.0 + at, WALL + at, WALL + at))
        at += wait
    return Stream(tuple(heard), frozenset({"odom"}))


def said(message: str = "run: in formation control", **values: str) -> Status:
    usual = {"state": "run", "robot link": "connected", "age odometry": "0.012", "age leader": "0.031"}
    usual["mission"] = TB3.fingerprint
    more = {key.replace("_", " "): value for key, value in values.items()}
    return Status("robot1: agent", 0, message, "robot1", {**usual, **more})


def signs(start: float, *, begin: float = 0.0, end: float = 3.0) -> list[tuple[float, float]]:
    """Signs of life of an agent that started `start` seconds before we listened."""
    moments = [begin + k / 20.0 for k in range(int((end - begin) * 20.0))]
    return [(100.0 + t, start + t) for t in moments]


HEALTHY = Facts(
    mission=TB3,
    robot="robot1",
    on_robot=True,
    wall=WALL,
    seconds=3.0,
    odometry=stream(),
    position=stream(),
    status=stream(2.0),
    said=said(),
    alive=tuple(signs(50.0)),
    router="tcp/127.0.0.1:7447",
    routed=True,
    guard_state="watching",
    guard_unit="active",
    listeners=(Party("turtlebot3_node", STAMPED, "ab"),),
    speakers=(Party("formation_agent", STAMPED, "cd"),),
    reached={"leader": Reached("tls/192.168.1.10:7460", "ok", name="leader")},
    certificates=(
        Certificate(path="c.pem", wanted="robot1", name="robot1", begins=WALL - DAY, ends=WALL + 29 * DAY),
    ),
    chrony=Chrony(0.000_04, synchronised=True),
    installed_differs="",
)
DESK = replace(
    HEALTHY,
    on_robot=False, odometry=None, position=None, alive=None, router=None, routed=None, guard_state=None,
    guard_unit=None, listeners=(), speakers=(), installed_differs=None,
    reached={"robot1": Reached("tls/192.168.1.11:7460", "ok", name="robot1")},
)  # fmt: skip


def found(facts: Facts) -> dict[str, str]:
    """Sentences of all that is wrong, by name."""
    return {
        finding.name: finding.sentence
        for checked in examine(EXAMINATIONS, facts)
        for finding in checked.findings
    }
