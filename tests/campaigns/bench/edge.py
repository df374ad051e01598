"""The scene that the edge is measured in: a follower and its two neighbours on a straight line."""

from __future__ import annotations

from formation.ros2.messages import Odometry, Pose

RATE = 50.0
"""Of odometry and of each neighbour's positions, where nothing else is said [Hz]."""
LEADER, NEIGHBOUR, FOLLOWER = "robot1", "robot2", "robot3"
SPEED = 0.2
"""Of everybody [m/s]."""
START = {LEADER: 0j, NEIGHBOUR: -1.0 + 0j, FOLLOWER: -2.3 + 0.1j}
"""Centres at the beginning [m]; the follower stays off its slot, so that its commands are not zero."""


def mission(rate: float = RATE) -> str:
    """The mission's file, everybody at `rate` [Hz]."""
    return f"""
name = "edge"
leader = "{LEADER}"
[robot]
control_point_offset = 0.2
max_speed = 1.5
max_turn_rate = 1.5
rate = {rate}
[shapes.line]
{NEIGHBOUR} = [-1.0, 0.0]
{FOLLOWER} = [-2.0, 0.0]
[robots.{LEADER}]
start = {{ x = 0.0, y = 0.0 }}
[robots.{NEIGHBOUR}]
neighbours = ["{LEADER}"]
start = {{ x = -1.0, y = 0.0 }}
[robots.{FOLLOWER}]
neighbours = ["{LEADER}", "{NEIGHBOUR}"]
start = {{ x = -2.0, y = 0.1 }}
[[route]]
speed = {SPEED}
heading_deg = 0
"""


def odometry(elapsed: float, wall: float) -> Odometry:
    """What the follower's robot says `elapsed` [s] after the beginning, at `wall` [s] by its clock."""
    return Odometry(wall, START[FOLLOWER] + SPEED * elapsed, 1.0 + 0j, SPEED, 0.0)


def position(robot: str, elapsed: float, wall: float) -> Pose:
    """What a neighbour says then."""
    return Pose(wall, START[robot] + SPEED * elapsed, 1.0 + 0j)
