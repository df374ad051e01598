"""`formation follow`: goals and paths of ROS become routes of the leader."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from formation.deploy.arguments import add_links, number, parser, read_mission
from formation.deploy.driving.ros import add_router, listening, router, topic
from formation.deploy.links import operator_bus
from formation.deploy.refusal import Refusal, refusing
from formation.mission.file import MISSION_HELP
from formation.mission.model import Mission
from formation.protocol.request import OperatorRequest
from formation.ros2.messages import WORLD_FRAME, Path, Pose, decode
from formation.stability import intent
from formation.stability.driving import first_limits
from formation.transport import asking
from formation.transport.bus import Bus
from formation.transport.bus_config import BusError
from formation.wire import BadMessage, Sample

ANSWER_SECONDS = 3.0
"""Wait for the answer to an order [s]."""
PERIOD_SECONDS = 0.1
"""Wait for messages, at most [s]."""
MAX_WAYPOINTS = 300
"""Most points of a route; of a longer path every other is left out, as often as needed."""
SPEED_SHARE = 0.6
"""Speed on the route by default, as a share of the greatest that followers can follow."""
EXAMPLES = """\
  formation follow convoy --goals /goal_pose         RViz: 2D Goal Pose
  formation follow convoy --paths /plan --speed 0.1  the path of Nav2's planner

Each goal (geometry_msgs/PoseStamped) is a straight route from where the leader is, each path
(nav_msgs/Path) a route along its points. Both must be in the frame map, the mission's world. The
newest replaces the one before. The answers of the leader are printed. A fleet that is held stays
held: `formation order MISSION run`.

Exit code 130: interrupted; 2: nothing was started.
"""


def main(arguments: Sequence[str]) -> int:
    """Order a route for each goal or path until interrupted; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    topics = tuple(topic for topic in (options.goals, options.paths) if topic)
    if not topics:
        raise Refusal("name what to follow: --goals TOPIC, --paths TOPIC, or both")
    speed = options.speed or SPEED_SHARE * first_limits(mission).speed
    with refusing(ValueError):
        intent.request_for(mission, "speed", speed=speed, degrees=0.0)
    with (
        refusing(BusError),
        operator_bus(options, mission, mission.candidates) as bus,
        listening(*router(options), topics) as ros,
    ):
        print(f"formation: following {', '.join(topics)}", file=sys.stderr, flush=True)
        while True:
            ros.wait(PERIOD_SECONDS)
            samples = ros.drain()
            if samples:
                print(answer(bus, mission, samples[-1], options.paths, speed), flush=True)


def answer(bus: Bus, mission: Mission, sample: Sample, paths: str | None, speed: float) -> str:
    """Order the route of one message; return the answers in words."""
    try:
        request = route(mission, waypoints(sample, paths), speed)
    except (BadMessage, ValueError) as error:
        return f"{sample.key}: {error}"
    recipients = asking.addressed(mission, request.do)
    return asking.give(bus.question, recipients, request, ANSWER_SECONDS).words()


def waypoints(sample: Sample, paths: str | None) -> list[complex]:
    """Return the points of a goal or, on the topic `paths`, of a path [m]. Raises BadMessage."""
    if paths is None or sample.key != paths.strip("/"):
        goal = decode(Pose, sample.payload)
        _check_frame(goal.frame)
        return [goal.position]
    path = decode(Path, sample.payload)
    _check_frame(path.frame)
    points = list(path.positions)
    if not points:
        raise BadMessage("the path has no points")
    while len(points) > MAX_WAYPOINTS:
        points = [*points[:-1:2], points[-1]]
    return points


def _check_frame(frame: str) -> None:
    """Raise BadMessage for points in another frame than the world's, such as RViz's fixed frame odom."""
    if frame.removeprefix("/") not in {"", WORLD_FRAME}:
        raise BadMessage(f"counts in frame {frame}, must be {WORLD_FRAME}")


def route(mission: Mission, points: Sequence[complex], speed: float) -> OperatorRequest:
    """Return the order of a route through `points` [m] at `speed` [m/s]. Raises ValueError."""
    places = [[round(point.real, 3), round(point.imag, 3)] for point in points]
    return intent.request_for(mission, "route", legs=[{"waypoints": places, "speed": speed}])


def _options() -> argparse.ArgumentParser:
    options = parser("follow", "Give the leader the goals and paths of ROS as routes.", EXAMPLES)
    options.add_argument("mission", metavar="MISSION", help=MISSION_HELP)
    options.add_argument(
        "--goals", type=topic, metavar="TOPIC", help="geometry_msgs/PoseStamped, such as /goal_pose"
    )
    options.add_argument("--paths", type=topic, metavar="TOPIC", help="nav_msgs/Path, such as /plan")
    options.add_argument(
        "--speed",
        type=number(0.0, 100.0, open_below=True),
        metavar="M/S",
        help="speed on the route (default: about half of the slowest robot's)",
    )
    add_router(options)
    add_links(options)
    return options
