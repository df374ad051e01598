"""`formation follow`: goals and paths of ROS as orders of a route."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.deploy.driving import follow
from formation.deploy.driving.follow import Follower, route, standing
from formation.deploy.driving.navigation import FEEDBACK_SECONDS, Navigation
from formation.deploy.driving.ros import MAX_WAITING
from formation.deploy.driving.waypoints import waypoints
from formation.deploy.refusal import Refusal
from formation.deploy.testing.pytest_plugin import MakeRehearsed
from formation.mission.file import load
from formation.mission.route import Straight, Waypoints
from formation.protocol.outcome import Answer, Outcome
from formation.protocol.request import OperatorReply, OperatorRequest, ReplyCode
from formation.ros2.goal_status import GoalStatus
from formation.ros2.messages import GoalStatuses, Message, Path, Pose, encode
from formation.transport import asking
from formation.transport.mailbox import Mailbox
from formation.transport.runtime.clock import monotonic
from formation.wire import BadMessage, Sample

CONVOY = load("convoy")


def test_goal_becomes_route_of_one_point() -> None:
    goal = Sample("goal_pose", encode(Pose(1.0, 2.0 + 1.0j, 1j)), None, 0.0)
    request = route(CONVOY, waypoints(goal, "/plan"), 0.1)
    assert (request.do, request.legs) == ("route", (Waypoints(waypoints=((2.0, 1.0),), speed=0.1),))


class Leader:
    """Answers each request as a leader does that obeys, unless told to refuse."""

    def __init__(self) -> None:
        self.requests: list[OperatorRequest] = []
        self.refuses: list[bool] = []
        self.code: ReplyCode = ""

    def give(self, request: OperatorRequest) -> Outcome:
        self.requests.append(request)
        refuses = self.refuses.pop() if self.refuses else False
        (name,) = CONVOY.candidates
        reply = OperatorReply(
            robot=name, ok=not refuses, mode="run", reason="out of bounds", code=self.code, leads=True
        )
        return Outcome(request, asking.addressed(CONVOY, "route"), {name: Answer(reply, 1.0)}, 0.0, 3.0)


BAD_MESSAGES = {
    "no points": Path(1.0, ()),
    "must be map": Path(1.0, (1.0 + 0j,), frame="odom"),
    "out of bounds": Path(1.0, (900.0 + 0j,)),
}


@pytest.mark.parametrize("why", BAD_MESSAGES)
def test_leader_stands_after_path_that_it_cannot_follow(why: str) -> None:
    leader = Leader()
    follower = Follower(leader.give, CONVOY, "/plan", 0.1)

    def take(message: Message) -> str:
        return follower.follow_message(Sample("plan", encode(message), None, 0.0))

    assert "stands" not in take(BAD_MESSAGES["no points"])  # the leader is on another's route
    assert "plan: to x = 1.00 m, y = -2.00 m\n" in take(Path(1.0, (0j, 1.0 - 2j)))
    leader.refuses = [False, True] if why == "out of bounds" else []
    says = take(BAD_MESSAGES[why])
    assert why in says
    assert "the leader stands until the next goal or path" in says
    (leg,) = leader.requests[-1].legs or ()
    assert isinstance(leg, Straight)
    assert (leg.speed, leader.requests[-1].joins) == (0.0, True)
    asked = len(leader.requests)
    take(BAD_MESSAGES["no points"])
    assert len(leader.requests) == asked  # it stands already


def test_path_refused_during_drive_stops_no_leader() -> None:
    leader = Leader()
    follower = Follower(leader.give, CONVOY, "/plan", 0.1)
    path = Sample("plan", encode(Path(1.0, (0j, 1.0 + 0j))), None, 0.0)
    follower.follow_message(path)
    leader.refuses, leader.code = [True], "driven"
    assert "stands" not in follower.follow_message(path)
    assert len(leader.requests) == 2


def test_of_many_goals_ten_per_second_become_orders(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    goal, leader, pauses = Sample("goal_pose", encode(Pose(1.0, 1.0 + 0j, 1j)), None, 0.0), Leader(), []

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 3:
            raise KeyboardInterrupt

    bus = SimpleNamespace(wait=lambda _: True, drain=lambda: [goal] * 100)
    monkeypatch.setattr(follow, "operator_bus", lambda *_: nullcontext(bus))
    monkeypatch.setattr(follow, "listening", lambda *_: nullcontext(bus))
    monkeypatch.setattr(follow, "_give", lambda _bus, _mission, request: leader.give(request))
    monkeypatch.setattr("time.sleep", pause)
    with pytest.raises(KeyboardInterrupt):
        follow.main(["convoy", "--goals", "/goal_pose"])
    assert pauses == [0.1] * 3
    assert len(leader.requests) == 3
    assert "the leader goes on along its route; to end it: formation order" in capsys.readouterr().err


def test_robots_follow_path_that_is_planned_every_second(rehearsed_fleet: MakeRehearsed) -> None:
    """Each path begins at the leader's robot, which is behind the leader's point."""
    fleet = rehearsed_fleet("convoy")
    fleet.run(2.0)
    begin, goal = fleet.position("robot1"), fleet.position("robot1") + 1.2
    for _ in range(14):
        here = fleet.position("robot1")
        plan = Path(1.0, tuple(here + (goal - here) * number / 40 for number in range(41)))
        found = waypoints(Sample("plan", encode(plan), None, 0.0), "/plan")
        request = route(CONVOY, found, 0.1)
        fleet._operator.order("route", legs=request.legs, joins=request.joins)
        fleet.run(1.0)
    assert abs(fleet.position("robot1") - begin) > 1.1
    assert fleet.error() < 0.1
    fleet._judge.expect("hold")
    fleet._operator.order("route", legs=standing(CONVOY).legs, joins=True)
    fleet.run(3.0)
    assert {fleet.command(name).speed for name in CONVOY.followers} <= {-0.01, 0.0, 0.01}


def test_empty_path_and_excessive_speed_are_refused() -> None:
    with pytest.raises(BadMessage, match="no points"):
        waypoints(Sample("plan", encode(Path(1.0, ())), None, 0.0), "/plan")
    with pytest.raises(ValueError, match="max_speed"):
        route(CONVOY, [1.0 + 0.0j], 5.0)


def test_follow_refuses_call_without_goals_or_path() -> None:
    with pytest.raises(Refusal, match="--goals TOPIC"):
        follow.main(["convoy"])


GOAL, NEXT_GOAL = bytes(16), bytes([1] * 16)
ACTION = "/navigate_to_pose"
STATUSES, FEEDBACK = "navigate_to_pose/_action/status", "navigate_to_pose/_action/feedback"
PATH = Path(1.0, (0j, 1.0 - 2j))


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The moment, which a test may change."""
    moment = [100.0]
    monkeypatch.setattr(follow, "monotonic", lambda: moment[0])
    return moment


def status(*statuses: tuple[bytes, GoalStatus], arrived: float = 100.0) -> Sample:
    return Sample(STATUSES, encode(GoalStatuses(statuses)), None, arrived)


def feedback(arrived: float, goal: bytes = GOAL) -> Sample:
    """A message as of any action: header of CDR, the goal, and what its type adds."""
    return Sample(FEEDBACK, bytes([0, 1, 0, 0]) + goal + bytes(100), None, arrived)


def path(arrived: float = 0.0) -> Sample:
    return Sample("plan", encode(PATH), None, arrived)


def navigated(leader: Leader) -> Follower:
    """Return a follower; its leader is on a path, as GOAL is active."""
    follower = Follower(leader.give, CONVOY, "/plan", 0.1, ACTION)
    list(follower.follow_messages([status((GOAL, GoalStatus.EXECUTING)), path()]))
    assert follower.follows
    return follower


@pytest.mark.usefixtures("now")
@pytest.mark.parametrize(
    ("ended", "word"),
    [
        (GoalStatus.CANCELING, "canceled"),
        (GoalStatus.CANCELED, "canceled"),
        (GoalStatus.ABORTED, "aborted"),
        (GoalStatus.UNKNOWN, "forgotten"),
    ],
)
def test_leader_stands_after_goal_is_canceled(ended: GoalStatus, word: str) -> None:
    leader = Leader()
    follower = navigated(leader)
    (words,) = follower.follow_messages([status((GOAL, ended))])
    assert f"the goal was {word}\n  the leader stands" in words
    assert leader.requests[-1].legs == standing(CONVOY).legs
    late = [status((GOAL, GoalStatus.EXECUTING)), path()]  # a repeated message: the goal stays ended
    (words,) = follower.follow_messages(late)
    assert "plan: not followed, no goal is active" in words
    assert len(leader.requests) == 2


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.usefixtures("now")
def test_path_of_canceled_goal_is_not_followed_for_next(*, together: bool) -> None:
    leader = Leader()
    follower = navigated(leader)
    messages = [path(100.0), status((GOAL, GoalStatus.CANCELED))]
    following = [status((GOAL, GoalStatus.CANCELED), (NEXT_GOAL, GoalStatus.ACCEPTED))]
    for samples in [messages + following] if together else [messages, following]:
        list(follower.follow_messages(samples))
    assert not follower.follows
    list(follower.follow_messages([path(100.0)]))
    assert follower.follows


@pytest.mark.usefixtures("now")
def test_goal_that_action_forgets_stops_leader() -> None:
    leader = Leader()
    (words,) = navigated(leader).follow_messages([status()])
    assert "the goal was forgotten\n  the leader stands" in words


@pytest.mark.usefixtures("now")
@pytest.mark.parametrize("next_status", [GoalStatus.SUCCEEDED, GoalStatus.ABORTED])
def test_leader_goes_on_after_success_or_with_next_goal(next_status: GoalStatus) -> None:
    leader = Leader()
    follower = navigated(leader)
    preempted = [(GOAL, next_status)]
    if next_status is GoalStatus.ABORTED:
        preempted.append((NEXT_GOAL, GoalStatus.ACCEPTED))
    assert not list(follower.follow_messages([status(*preempted)]))
    assert len(leader.requests) == 1


def test_path_just_before_its_goal_is_followed(now: list[float]) -> None:
    leader = Leader()
    follower = Follower(leader.give, CONVOY, "/plan", 0.1, ACTION)
    for arrived, followed in ((now[0], True), (now[0] - 0.6, False)):
        goal = bytes([len(leader.requests) + 1] * 16)
        (words,) = follower.follow_messages([path(arrived)])
        assert "not followed" in words
        assert len(list(follower.follow_messages([status((goal, GoalStatus.ACCEPTED))]))) == followed
        list(follower.follow_messages([status((goal, GoalStatus.SUCCEEDED))]))
    assert len(leader.requests) == 1


def test_leader_that_does_not_obey_is_told_again_to_stand(now: list[float]) -> None:
    leader = Leader()
    follower = navigated(leader)
    leader.refuses = [True]
    (words,) = follower.follow_messages([status((GOAL, GoalStatus.CANCELED))])
    assert "the goal was canceled\n  NOT STOPPED" in words
    assert not list(follower.follow_messages([]))
    now[0] += 1.0
    (words,) = follower.follow_messages([])
    assert "the goal was canceled\n  the leader stands" in words
    now[0] += 1.0
    assert not list(follower.follow_messages([]))


def test_silent_feedback_stops_leader_until_next_goal(now: list[float]) -> None:
    """Nav2 has crashed, or lost the robot's pose, behind a bridge that lives."""
    leader = Leader()
    follower = navigated(leader)
    for _ in range(10):
        now[0] += 0.9 * FEEDBACK_SECONDS
        assert not list(follower.follow_messages([feedback(now[0])]))
    now[0] += 1.1 * FEEDBACK_SECONDS
    (words,) = follower.follow_messages([])
    assert f"no message on {FEEDBACK} about the active goal for 2 s" in words
    assert "send the goal again\n  the leader stands" in words
    again = [status((GOAL, GoalStatus.EXECUTING), arrived=now[0]), feedback(now[0]), path(now[0])]
    (words,) = follower.follow_messages(again)
    assert "not followed" in words
    after = [status((NEXT_GOAL, GoalStatus.EXECUTING), arrived=now[0]), path(now[0])]
    (words,) = follower.follow_messages(after)
    assert "plan: to x = 1.00 m" in words


@pytest.mark.parametrize("kind", ["of another goal", "too short"])
def test_feedback_that_tells_nothing_of_goal_counts_as_silence(now: list[float], kind: str) -> None:
    leader = Leader()
    follower = navigated(leader)
    now[0] += 1.1 * FEEDBACK_SECONDS
    message = feedback(now[0], NEXT_GOAL)
    if kind == "too short":
        message = message._replace(payload=message.payload[:19])
    (words,) = follower.follow_messages([message])
    assert "the leader stands" in words


def test_path_of_silent_action_is_not_followed(now: list[float]) -> None:
    leader = Leader()
    follower = Follower(leader.give, CONVOY, "/plan", 0.1, ACTION)
    list(follower.follow_messages([status((GOAL, GoalStatus.EXECUTING))]))
    now[0] += 1.1 * FEEDBACK_SECONDS
    (words,) = follower.follow_messages([path(now[0])])
    assert "plan: not followed, no message on" in words
    (words,) = follower.follow_messages([feedback(now[0]), path(now[0])])
    assert "plan: to x = 1.00 m" in words


def test_next_goal_has_time_for_its_first_feedback(now: list[float]) -> None:
    """The leader is still on the route to the goal before, which has been reached."""
    leader = Leader()
    follower = navigated(leader)
    list(follower.follow_messages([status((GOAL, GoalStatus.SUCCEEDED))]))
    now[0] += 5.0
    assert not list(follower.follow_messages([status((NEXT_GOAL, GoalStatus.ACCEPTED), arrived=now[0])]))
    now[0] += 1.1 * FEEDBACK_SECONDS
    (words,) = follower.follow_messages([])
    assert "the leader stands" in words


@pytest.mark.usefixtures("now")
def test_invalid_status_stops_leader() -> None:
    leader = Leader()
    follower = navigated(leader)
    (words,) = follower.follow_messages([Sample(STATUSES, encode(PATH), None, 0.0)])
    assert f"{STATUSES}: action_msgs/msg/GoalStatusArray: " in words
    assert "the leader stands" in words
    (words,) = follower.follow_messages([path()])
    assert "not followed" in words  # it may have said that the goal was canceled


class RosBus(Mailbox):
    """A bus with the capacity of `listening`; instead of each wait the next of `turns` happens."""

    def __init__(self, topics: tuple[str, ...], turns: list[Callable[[], None]]) -> None:
        super().__init__(MAX_WAITING)
        self.links, self.topics, self._turns = 1, [topic.strip("/") for topic in topics], turns

    def wait(self, _: float) -> bool:
        if not self._turns:
            raise KeyboardInterrupt
        self._turns.pop(0)()
        return True


def requested(monkeypatch: pytest.MonkeyPatch, *turns: Callable[[list[RosBus]], None]) -> list[bool]:
    """Run the command with an action for `turns`, which get its buses; return which orders were to stand."""
    leader, buses = Leader(), list[RosBus]()
    left: list[Callable[[], None]] = [partial(turn, buses) for turn in turns]

    def listening(_endpoint: str, _domain: int, topics: tuple[str, ...]) -> AbstractContextManager[RosBus]:
        buses.append(RosBus(topics, left))
        return nullcontext(buses[-1])

    monkeypatch.setattr(follow, "operator_bus", lambda *_: nullcontext())
    monkeypatch.setattr(follow, "listening", listening)
    monkeypatch.setattr(follow, "_give", lambda _bus, _mission, request: leader.give(request))
    monkeypatch.setattr("time.sleep", lambda _: None)
    with pytest.raises(KeyboardInterrupt):
        follow.main(["convoy", "--paths", "/plan", "--action", "/navigate_to_pose"])
    return [request.legs == standing(CONVOY).legs for request in leader.requests]


def publish(buses: list[RosBus], *samples: Sample) -> None:
    for sample in samples:
        for bus in buses:
            if sample.key in bus.topics:
                bus.put(sample)


def set_out(buses: list[RosBus]) -> None:
    publish(buses, status((GOAL, GoalStatus.EXECUTING), arrived=monotonic()), path(monotonic()))


def test_many_messages_push_no_status_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a leader's answer takes up to 3 s, or at 1000 Hz."""

    def cancel(buses: list[RosBus]) -> None:
        at = monotonic()
        feedbacks, paths = [feedback(at)] * 1000, [path(at)] * 1000
        publish(buses, status((GOAL, GoalStatus.CANCELED), arrived=at), *feedbacks, *paths)

    assert requested(monkeypatch, set_out, cancel) == [False, True]


def test_lost_link_to_action_stops_leader_until_next_goal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def link(buses: list[RosBus], links: int) -> None:
        for bus in buses:
            bus.links = links

    def go_on(buses: list[RosBus]) -> None:
        link(buses, 1)
        publish(buses, status((GOAL, GoalStatus.EXECUTING), arrived=monotonic()), path(monotonic()))

    def next_goal(buses: list[RosBus]) -> None:
        publish(buses, status((NEXT_GOAL, GoalStatus.EXECUTING), arrived=monotonic()), path(monotonic()))

    turns = set_out, partial(link, links=0), go_on, next_goal
    assert requested(monkeypatch, *turns) == [False, True, False]
    assert "bridge or router is lost; send the goal again\n  the leader stands" in capsys.readouterr().out


def test_goals_count_without_active_action() -> None:
    leader = Leader()
    follower = Follower(leader.give, CONVOY, "/plan", 0.1, ACTION)
    goal = Sample("goal_pose", encode(Pose(1.0, 1.0 + 0j, 1j)), None, 0.0)
    (words,) = follower.follow_messages([path(), goal])
    assert "goal_pose: to x = 1.00 m" in words


@given(st.lists(st.dictionaries(st.sampled_from([GOAL, NEXT_GOAL]), st.sampled_from(GoalStatus))))
def test_ended_goal_is_never_active_again(messages: list[dict[bytes, GoalStatus]]) -> None:
    navigation, seen, ended = Navigation(), set[bytes](), set[bytes]()
    for message in messages:
        navigation.update(GoalStatuses(tuple(message.items())), 0.0)
        running = {
            goal for goal, one in message.items() if one in {GoalStatus.ACCEPTED, GoalStatus.EXECUTING}
        }
        seen |= message.keys()
        ended |= seen - running
        assert navigation.active == bool(running - ended)


def test_follow_refuses_action_without_paths() -> None:
    with pytest.raises(Refusal, match="--action is of use with --paths only"):
        follow.main(["convoy", "--goals", "/goal_pose", "--action", "/navigate_to_pose"])
