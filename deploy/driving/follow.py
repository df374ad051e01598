"""`formation follow`: goals and paths of ROS become routes of the leader."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from operator import attrgetter
from typing import NoReturn

from formation.deploy.arguments import add_links, number, parser, read_mission
from formation.deploy.driving.navigation import FEEDBACK_SECONDS, Navigation
from formation.deploy.driving.ros import add_router, listening, router, topic
from formation.deploy.driving.waypoints import waypoints
from formation.deploy.links import operator_bus
from formation.deploy.refusal import Refusal, refuse_errors
from formation.mission.file import MISSION_HELP
from formation.mission.model import Mission
from formation.mission.route import Straight
from formation.protocol.outcome import Outcome
from formation.protocol.request import OperatorRequest
from formation.ros2.goal_status import feedback_goal
from formation.ros2.messages import GoalStatuses, decode
from formation.stability import intent
from formation.stability.driving import first_limits
from formation.topics import action_feedback, action_statuses
from formation.transport import asking
from formation.transport.bus import Bus
from formation.transport.bus_config import BusError
from formation.transport.runtime.clock import monotonic
from formation.wire import BadMessage, Sample

ANSWER_SECONDS = 3.0
"""Wait for the answer to an order [s]."""
PERIOD_SECONDS = 0.1
"""Wait for messages, at most, and from one answer to the next order [s]."""
EARLY_SECONDS = 0.5
"""Age up to which a path counts that came before the status of its goal [s]: they are separate topics."""
RETRY_SECONDS = 1.0
"""Time after which a leader that did not obey is told again to stand [s]."""
SPEED_SHARE = 0.6
"""Speed on the route by default, as a share of the greatest that followers can follow."""
END = "to end it: formation order MISSION hold"
EXAMPLES = """\
  formation follow convoy --goals /goal_pose         RViz: 2D Goal Pose
  formation follow convoy --paths /plan --speed 0.1  the path of Nav2's planner
  formation follow convoy --paths /plan --action /navigate_to_pose
                                                     also stand when the goal is canceled in Nav2

Each goal (geometry_msgs/PoseStamped) is a straight route from where the leader is, each path
(nav_msgs/Path) a route along its points. Both must be in the frame map, the mission's world. The
newest replaces the one before. A path may be sent again and again, as Nav2 does: the leader goes on
from where it is. The answers of the leader are printed. A fleet that is held stays held:
`formation order MISSION run`. While a driver moves the leader by hand, and 1 s longer, it refuses
goals and paths.

With --action, paths count only while that action works at a goal, by its status and its feedback. The
leader stands when the goal is canceled or aborted, when the feedback is silent for 2 s, as after a crash
of Nav2, or when the link to the bridge or router is lost. Without it, the leader learns nothing of that:
order `hold`, or send a path without points. The leader also stands after a path
without points, and after a goal or path that it cannot follow, until the next. It learns nothing of the
end of this command.

Exit code 130: interrupted; 2: nothing was started.
"""


def main(arguments: Sequence[str]) -> int:
    """Order a route for each goal or path until interrupted; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    topics = tuple(topic for topic in (options.goals, options.paths) if topic)
    if not topics:
        raise Refusal("name what to follow: --goals TOPIC, --paths TOPIC, or both")
    if options.action and not options.paths:
        raise Refusal("--action is of use with --paths only")
    speed = options.speed or SPEED_SHARE * first_limits(mission).speed
    with refuse_errors(ValueError):
        intent.request_for(mission, "speed", speed=speed, degrees=0.0)
    groups = [topics]  # on a bus each: of many messages the oldest are lost, and no status may be
    if options.action:
        groups += [(action_statuses(options.action),), (action_feedback(options.action),)]
    with (
        refuse_errors(BusError),
        operator_bus(options, mission, mission.candidates) as bus,
        ExitStack() as stack,
    ):
        ros, *action = [stack.enter_context(listening(*router(options), group)) for group in groups]
        follower = Follower(partial(_give, bus, mission), mission, options.paths, speed, options.action)
        when = f", paths while {options.action} works at a goal" if options.action else ""
        print(f"formation: following {', '.join(topics)}{when}", file=sys.stderr, flush=True)
        try:
            _follow(ros, action, follower)
        finally:
            if follower.follows:
                print(f"\nformation: the leader goes on along its route; {END}", file=sys.stderr)


def _follow(ros: Bus, action: Sequence[Bus], follower: Follower) -> NoReturn:
    """Print the answers to the newest message, again and again.

    `action` receives the statuses and the feedback, if there is one.
    """
    linked = False
    while True:
        (*action, ros)[0].wait(PERIOD_SECONDS)
        samples = [sample for bus in (ros, *action) for sample in bus.drain()]
        for words in follower.follow_messages(sorted(samples, key=attrgetter("arrived"))):
            print(words, flush=True)
        before, linked = linked, bool(action) and all(bus.links > 0 for bus in action)
        if before and not linked:
            why = "the link to the ROS 2 bridge or router is lost; send the goal again"
            print(follower.doubt(why), flush=True)
        if samples:
            time.sleep(PERIOD_SECONDS)  # of many messages the newest counts


class Follower:
    """Orders a route for each goal or path."""

    def __init__(
        self,
        give: Callable[[OperatorRequest], Outcome],
        mission: Mission,
        paths: str | None,
        speed: float,
        action: str | None = None,
    ) -> None:
        """`give` sends a request and awaits the answers; `speed` in m/s.

        `paths` is the topic of paths, `action` the action that works at their goals.
        """
        self._give, self._mission, self._speed = give, mission, speed
        self._paths = paths.strip("/") if paths else None
        self._statuses = action_statuses(action) if action else None
        self._feedback = action_feedback(action) if action else None
        self._navigation = Navigation()
        self._early: Sample | None = None
        """A path that came before its goal was active."""
        self._why, self._retry_at = "", 0.0
        """Why the leader must stand that did not obey, and when it is told again [s, monotonic]."""
        self.follows = False
        """Whether the leader may be on a route from here."""

    def follow_messages(self, samples: Sequence[Sample]) -> Iterator[str]:
        """Take messages: every status, and of goals and paths the newest. Yields the answers in words."""
        newest = None
        for sample in samples:
            if sample.key == self._feedback:
                with suppress(BadMessage):  # counts as silence
                    self._navigation.note_feedback(feedback_goal(sample.payload), sample.arrived)
                continue
            if sample.key != self._statuses:
                newest = sample
                continue
            worked = self._navigation.active
            if words := self._follow_status(sample):
                yield words
            if worked and not self._navigation.active:  # a path from before is that of an ended goal
                self._early = None
                newest = newest if newest is not None and newest.key != self._paths else None
        works = not self._statuses or self._navigation.works(monotonic())
        yield from self._follow_newest(newest, works=works)
        if self.follows and self._navigation.active and not works:
            yield self.doubt(f"{self._why_idle}: see whether it runs, then send the goal again")
        if self._why and monotonic() >= self._retry_at:
            yield self._stand(self._why)

    def _follow_newest(self, newest: Sample | None, *, works: bool) -> Iterator[str]:
        """Take the newest goal or path, a path only if the action `works`; or an early path, which waited."""
        early, self._early = self._early, None
        if newest is None and early is not None and monotonic() - early.arrived < EARLY_SECONDS:
            newest = early
        if newest is not None and (works or newest.key != self._paths):
            yield self.follow_message(newest)
        elif newest is not None:
            if newest is not early:
                yield f"{newest.key}: not followed, {self._why_idle}"
            self._early = newest

    @property
    def _why_idle(self) -> str:
        if not self._navigation.active:
            return f"no goal is active by {self._statuses}"
        return f"no message on {self._feedback} about the active goal for {FEEDBACK_SECONDS:g} s"

    def _follow_status(self, sample: Sample) -> str:
        """Take a message of the action; return what follows from it, in words."""
        try:
            ended = self._navigation.update(decode(GoalStatuses, sample.payload), sample.arrived)
        except BadMessage as error:
            return self.doubt(f"{sample.key}: {error}")
        return self._stand(f"{sample.key}: the goal was {ended}") if ended else ""

    def doubt(self, why: str) -> str:
        """Let the leader stand until the next goal, as this one may have ended; return the words."""
        self._navigation.update(GoalStatuses(()), monotonic())
        self._early = None
        return self._stand(why)

    def follow_message(self, sample: Sample) -> str:
        """Order the route of one message; return the answers in words."""
        try:
            points = waypoints(sample, self._paths)
            request = route(self._mission, points, self._speed)
        except (BadMessage, ValueError) as error:
            return self._stand(f"{sample.key}: {error}")
        outcome = self._give(request)
        words = (
            f"{sample.key}: to x = {points[-1].real:.2f} m, y = {points[-1].imag:.2f} m\n{outcome.words()}"
        )
        if _driven(outcome):
            return words
        if outcome.refused:
            return self._stand(words)
        self.follows, self._why = True, ""
        return words

    def _stand(self, why: str) -> str:
        """Let the leader stand that followed an earlier message; return `why`, and whether it stands."""
        if not self.follows:
            return why
        outcome = self._give(standing(self._mission))
        self.follows = False
        if outcome.obeyed:
            then = "the leader stands until the next goal or path"
        elif _driven(outcome):
            then = "it is driven by hand"
        else:
            self.follows, then = True, f"NOT STOPPED: {outcome.summary()}"
        self._why, self._retry_at = why if self.follows else "", monotonic() + RETRY_SECONDS
        return f"{why}\n  {then}"


def _driven(outcome: Outcome) -> bool:
    """Whether the leader refuses because it is driven by hand: it is on no route then."""
    return any(answer.reply.code == "driven" for answer in outcome.answers.values())


def route(mission: Mission, points: Sequence[complex], speed: float) -> OperatorRequest:
    """Return the order of a route through `points` [m] at `speed` [m/s]. Raises ValueError."""
    places = [[round(point.real, 3), round(point.imag, 3)] for point in points]
    request = intent.request_for(mission, "route", legs=[{"waypoints": places, "speed": speed}])
    return request.model_copy(update={"joins": True})


def standing(mission: Mission) -> OperatorRequest:
    """Return the order to stand: a route that ends soon, on which the leader keeps its place and heading."""
    request = intent.request_for(mission, "route", legs=[Straight(speed=0.0, heading_deg=0.0, duration=0.1)])
    return request.model_copy(update={"joins": True})


def _give(bus: Bus, mission: Mission, request: OperatorRequest) -> Outcome:
    return asking.give(bus.question, asking.addressed(mission, request.do), request, ANSWER_SECONDS)


def _options() -> argparse.ArgumentParser:
    options = parser("follow", "Give the leader the goals and paths of ROS as routes.", EXAMPLES)
    options.add_argument("mission", metavar="MISSION", help=MISSION_HELP)
    options.add_argument(
        "--goals", type=topic, metavar="TOPIC", help="geometry_msgs/PoseStamped, such as /goal_pose"
    )
    options.add_argument("--paths", type=topic, metavar="TOPIC", help="nav_msgs/Path, such as /plan")
    options.add_argument(
        "--action",
        type=topic,
        metavar="ACTION",
        help="stand when its goal is canceled or aborted, such as /navigate_to_pose; needs --paths",
    )
    options.add_argument(
        "--speed",
        type=number(0.0, 100.0, "m/s", open_below=True),
        metavar="M/S",
        help="speed on the route (default: 0.6 of the slowest robot's top speed)",
    )
    add_router(options)
    add_links(options)
    return options
