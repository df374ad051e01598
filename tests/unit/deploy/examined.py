"""Facts for tests of the doctor: a healthy robot, a healthy desk, and the findings of others."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate
from typing import Any

from formation.deploy.doctor.cli import EXAMINATIONS
from formation.deploy.doctor.facts import (
    Certificate,
    Chrony,
    Facts,
    Reached,
    ReceivedMessage,
    RosNode,
    Stream,
    examine,
)
from formation.mission.file import load
from formation.protocol.reasons import Code, Reason
from formation.protocol.status import AgentState, AgentStatus, RobotLink

TB3 = load("turtlebot3_pair")
WALL = 1.8e9
DAY = 86_400.0
STAMPED, TWIST = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/Twist"


def stream(
    rate: float = 20.0, seconds: float = 3.0, behind: float = 0.002, frames: tuple[str, ...] = ("odom",)
) -> Stream:
    times = [k / rate for k in range(int(seconds * rate))]
    received = tuple(ReceivedMessage(100.0 + t, WALL + t - behind, WALL + t) for t in times)
    return Stream(received, frozenset(frames))


def paused(*pauses: float) -> Stream:
    """A stream of 20 Hz for 3 s, with pauses."""
    waits = [*pauses, *[0.05] * round((3.0 - sum(pauses)) / 0.05)]
    times = accumulate(waits[:-1], initial=0.0)
    return Stream(tuple(ReceivedMessage(100.0 + t, WALL + t, WALL + t) for t in times), frozenset({"odom"}))


def status_of(**values: Any) -> AgentStatus:
    usual = AgentStatus(
        robot="robot1", state=AgentState.RUN, reason=Reason(Code.RUNNING), link=RobotLink.CONNECTED,
        age={"odometry": 0.012, "leader": 0.031}, mission=TB3.fingerprint,
    )  # fmt: skip
    return replace(usual, **values)


def signs(start: float, *, begin: float = 0.0, end: float = 3.0) -> list[tuple[float, float]]:
    """Signs of life of an agent that started `start` seconds before the doctor listened."""
    moments = [begin + k / 20.0 for k in range(int((end - begin) * 20.0))]
    return [(100.0 + t, start + t) for t in moments]


HEALTHY = Facts(
    mission=TB3,
    robot="robot1",
    on_robot=True,
    wall=WALL,
    seconds=3.0,
    ended=103.0,
    odometry=stream(),
    position=stream(),
    status=stream(2.0),
    newest_status=status_of(),
    alive=tuple(signs(50.0)),
    router="tcp/127.0.0.1:7447",
    routed=True,
    watchdog_state="watching",
    watchdog_unit="active",
    subscribers=(RosNode("turtlebot3_node", STAMPED),),
    publishers=(RosNode("_formation_agent", STAMPED),),
    reached={"leader": Reached("tls/192.168.1.10:7460", "ok", name="leader")},
    certificate=Certificate(
        path="c.pem", wanted="robot1", name="robot1", begins=WALL - DAY, ends=WALL + 29 * DAY
    ),
    chrony=Chrony(0.000_04, synchronised=True),
    installed_differs="",
)
DESK = replace(
    HEALTHY,
    on_robot=False, odometry=None, position=None, alive=None, router=None, routed=None, watchdog_state=None,
    watchdog_unit=None, subscribers=(), publishers=(), installed_differs=None,
    reached={"robot1": Reached("tls/192.168.1.11:7460", "ok", name="robot1")},
)  # fmt: skip


def found(facts: Facts) -> dict[str, str]:
    """Sentences of all findings, by name."""
    return {
        finding.name: finding.sentence
        for checked in examine(EXAMINATIONS, facts)
        for finding in checked.findings
    }
