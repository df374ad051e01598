"""An operator's word: who is asked, how often, until when."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, get_args

import pytest

from formation import order
from formation.legs import Straight
from formation.mission import Mission
from formation.mission_file import load
from formation.order import MAX_REQUEST, Do, Mode, OperatorReply, OperatorRequest
from formation.outcome import Asked, Outcome
from formation.rest import MOTION, Rest
from formation.transport import asking
from formation.transport.question import Question, Reply

STOP = OperatorRequest(do="stop")
SIX = load("six_robots")
TWO = Asked(("robot1",), ("robot2",))
"""A leader and a robot."""


class Clock:
    """In place of `time`: goes on only while somebody sleeps."""

    def __init__(self) -> None:
        self.now = 0.0
        """[s]"""

    def time(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """What questions are timed by here, however busy this machine is."""
    clock = Clock()
    monkeypatch.setattr(asking, "_now", clock.time)
    monkeypatch.setattr(asking, "time", clock)
    return clock


def reply(
    robot: str, *, ok: bool = True, mode: Mode = "stop", key: str = "", leads: bool | None = None
) -> Reply:
    said = OperatorReply(robot=robot, ok=ok, mode=mode, leads=leads)
    return Reply(key or f"{robot}/order", order.encode(said), 1.5)


class Fleet:
    """Answers each question with the next of the lists of replies on its key, the last of them for ever."""

    def __init__(self, **rounds: Sequence[Sequence[Reply]]) -> None:
        self.rounds = {name: list(one) for name, one in rounds.items()}
        self.put_to: list[str] = []
        self.silent = False
        """Somebody is linked, and says nothing: no question to all is over before its time."""

    def put(self, key: str, payload: bytes, timeout: float) -> Question:
        assert 0.0 < timeout <= asking.ROUND
        order.decode(OperatorRequest, payload)
        question, name = Question(), key.removesuffix("/order").replace("*", "all")
        self.put_to.append(name)
        rounds = self.rounds.get(name, [[]])
        question.replies += rounds.pop(0) if len(rounds) > 1 else rounds[0]
        if not self.silent:
            question.end()
        return question


def test_a_question_to_all_is_put_again_until_everybody_has_answered() -> None:
    one, two = reply("robot1"), reply("robot2")
    fleet = Fleet(all=[[], [one], [one, two], [two]])
    outcome = asking.ask(fleet.put, TWO, STOP, 10.0)
    assert outcome.obeyed
    assert fleet.put_to == ["all"] * 3


def test_the_first_answer_of_a_robot_counts_and_not_what_it_says_to_the_repetition() -> None:
    fleet = Fleet(all=[[reply("robot2")], [reply("robot2", mode="hold"), reply("robot1")]])
    outcome = asking.ask(fleet.put, TWO, STOP, 10.0)
    assert outcome.answers["robot2"].reply.mode == "stop"
    assert outcome.answers["robot2"].ms < outcome.answers["robot1"].ms


def test_who_is_linked_and_silent_keeps_nobody_waiting() -> None:
    fleet = Fleet(all=[[reply("robot1")], [], [], [reply("robot3")]])
    fleet.silent = True
    outcome = asking.ask(fleet.put, Asked(("robot1",), ("robot2", "robot3")), STOP, 0.4)
    assert outcome.missing == ["robot2"]
    assert outcome.answers["robot3"].ms < 1e3 * asking.ROUND


def test_of_several_who_may_lead_each_is_asked_by_its_own_key_and_nobody_else() -> None:
    fleet = Fleet(robot1=[[reply("robot1", leads=False)]], spare=[[], [], [reply("spare", leads=True)]])
    outcome = asking.ask(fleet.put, Asked(("robot1", "spare")), OperatorRequest(do="run"), 10.0)
    assert outcome.leader == "spare"
    assert set(fleet.put_to) == {"robot1", "spare"}


def test_a_question_that_hangs_on_somebody_elses_link_is_put_again_soon() -> None:
    fleet = Fleet(robot1=[[], [], [reply("robot1")]])
    fleet.silent = True
    outcome = asking.ask(fleet.put, Asked(("robot1",)), STOP, 10.0)
    assert outcome.answers["robot1"].ms < 1e3 * asking.ROUND


def test_an_answer_to_a_question_before_the_newest_counts() -> None:
    late = Question()
    questions = iter([late, Question(), Question()])

    def put(_key: str, _payload: bytes, _: float) -> Question:
        question = next(questions)
        if question is not late:
            late.replies.append(reply("robot1"))
            late.end()
        return question

    assert asking.ask(put, Asked(("robot1",)), STOP, 10.0).obeyed


def test_what_is_waited_for_counts_from_the_first_question_to_anybody() -> None:
    fleet = Fleet(all=[[reply("robot1")], [], [reply("robot2")]])
    outcome = asking.ask(fleet.put, TWO, STOP, 10.0)
    assert outcome.answers["robot1"].ms == pytest.approx(1.5, abs=1.0)
    assert outcome.answers["robot2"].ms > 2e3 * asking.AGAIN


def test_who_does_not_answer_in_time_is_missing() -> None:
    outcome = asking.ask(Fleet(all=[[reply("robot1")]]).put, TWO, STOP, 0.1)
    assert (set(outcome.answers), outcome.missing) == ({"robot1"}, ["robot2"])


def test_answers_that_are_garbage_or_of_strangers_or_in_anothers_name_count_for_nothing() -> None:
    strange = [
        Reply("robot1/order", b"yes", 1.0),
        reply("robot9"),
        reply("robot2", key="robot1/order"),
    ]
    assert asking.ask(Fleet(all=[strange]).put, TWO, STOP, 0.05).answers == {}


def test_question_to_all_waits_for_links(clock: Clock) -> None:
    """One question at the first link, one when all are linked; none in between, nor before."""
    both = [reply("robot1"), reply("robot2")]
    fleet = Fleet(all=[both[:1], both])
    put_at: list[float] = []

    def put(key: str, payload: bytes, timeout: float) -> Question:
        put_at.append(clock.now)
        return fleet.put(key, payload, timeout)

    def linked() -> int:
        return (clock.now >= 0.05) + (clock.now >= 0.10)

    outcome = asking.ask(put, TWO, STOP, 10.0, linked=linked)
    assert outcome.obeyed
    assert put_at == [pytest.approx(0.05, abs=2 * asking.LOOK), pytest.approx(0.10, abs=2 * asking.LOOK)]


def test_question_to_all_is_repeated_while_a_link_is_missing() -> None:
    fleet = Fleet(all=[[reply("robot1")]])
    outcome = asking.ask(fleet.put, TWO, STOP, 1.0, linked=lambda: 1)
    assert outcome.missing == ["robot2"]
    assert len(fleet.put_to) == pytest.approx(1.0 / asking.LINKING_PAUSE, abs=1.0)


def test_what_is_over_is_not_asked_again() -> None:
    fleet = Fleet(all=[[reply("robot1")]])
    outcome = asking.ask(fleet.put, TWO, STOP, 10.0, over=lambda: len(fleet.put_to) >= 5)
    assert not outcome.obeyed
    assert len(fleet.put_to) == 5


def test_who_stands_by_is_asked_again_until_one_leads() -> None:
    waits, leads = reply("robot2", leads=False), reply("robot2", leads=True)
    fleet = Fleet(robot2=[[waits], [waits], [leads]])
    outcome = asking.ask(fleet.put, Asked(("robot1", "robot2")), OperatorRequest(do="run"), 10.0)
    assert (outcome.leader, outcome.obeyed) == ("robot2", True)
    assert fleet.put_to.count("robot2") == 3


def test_of_two_who_answer_for_one_name_the_one_that_leads_counts() -> None:
    both = [reply("robot1", leads=False), reply("robot1", leads=True, mode="hold")]
    outcome = asking.ask(Fleet(robot1=[both]).put, Asked(("robot1",)), OperatorRequest(do="hold"), 10.0)
    assert outcome.answers["robot1"].reply.mode == "hold"


def test_others_who_may_lead_have_a_moment_more_and_a_dead_one_keeps_nobody(clock: Clock) -> None:
    fleet = Fleet(robot2=[[reply("robot2", leads=True)]], robot3=[[], [], [reply("robot3", leads=False)]])
    outcome = asking.ask(fleet.put, Asked(("robot1", "robot2", "robot3")), OperatorRequest(do="run"), 10.0)
    assert clock.now < 5.0
    assert (outcome.obeyed, outcome.standing_by) == (True, ["robot3"])


def with_standbys() -> Mission:
    data = SIX.model_dump()
    return Mission.model_validate({**data, "standbys": {"second": {}, "third": {}}})


@pytest.mark.parametrize("do", get_args(Do))
def test_what_changes_motion_is_put_to_every_robot(do: Do) -> None:
    mission = with_standbys()
    asked = asking.addressed(mission, do)
    assert asked.candidates == ("robot1", "second", "third")
    assert asked.each == (mission.followers if do in MOTION else ())


def test_each_request_has_an_id_of_its_own_and_a_shape_is_one_of_the_missions() -> None:
    assert len({asking.request_for(SIX, "stop").id for _ in range(10)}) == 10
    assert asking.request_for(SIX, "shape", shape="wedge").shape == "wedge"
    for shape in (None, "circle", ""):
        with pytest.raises(ValueError, match="must be one of hexagon, wedge"):
            asking.request_for(SIX, "shape", shape=shape)


@pytest.mark.parametrize(
    ("do", "what", "said"),
    [
        ("fly", {}, "'fly': must be one of hold, run, stop, release, shape"),
        ("hold", {"shape": "wedge"}, "hold: takes no shape"),
        ("rotate", {}, "rotate: rotate takes degrees"),
        ("rotate", {"degrees": 4000.0}, "degrees = 4000.0: must be less than or equal to 3600"),
        ("rotate", {"degrees": "30"}, "degrees = '30': must be a valid number"),
        ("scale", {"factor": 0.0}, "factor = 0.0: must be greater than or equal to 0.001"),
        ("speed", {"speed": 0.1}, "speed takes speed and degrees"),
    ],
)
def test_what_cannot_be_asked_is_named_with_what_can(do: str, what: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said.replace("(", r"\(")):
        asking.request_for(SIX, do, **what)


def test_a_route_that_is_longer_than_anybody_reads_is_not_sent() -> None:
    legs = [Straight(speed=0.1, heading_deg=100.0 / 3.0, duration=100.0 / 3.0)] * 300
    with pytest.raises(ValueError, match=f"route: too long, at most {MAX_REQUEST} bytes are sent"):
        asking.request_for(SIX, "route", legs=legs)
    assert len(order.encode(asking.request_for(SIX, "route", legs=legs[:100]))) < MAX_REQUEST


def test_every_order_says_how_old_it_is_and_only_its_first_question_is_new() -> None:
    for do in ("release", "run", "stop", "hold"):
        heard: list[OperatorRequest] = []

        def put(_key: str, payload: bytes, _: float, heard: list[OperatorRequest] = heard) -> Question:
            heard.append(order.decode(OperatorRequest, payload))
            question = Question()
            question.end()
            return question

        asking.ask(put, Asked(("robot1",)), asking.request_for(SIX, do), 0.2)
        ages = [one.age for one in heard]
        assert ages[0] == 0.0 < ages[1]
        assert ages[-1] > 0.1
        assert ages == sorted(ages)


def test_what_is_put_after_a_laptop_has_slept_is_as_old_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    heard, clock = [], iter([0.0, 0.0, 600.0, 600.0])
    monkeypatch.setattr(asking, "_now", lambda: next(clock))

    def put(_key: str, payload: bytes, _: float) -> Question:
        heard.append(order.decode(OperatorRequest, payload))
        question = Question()
        question.end()
        return question

    asking.ask(put, Asked(("robot1",)), asking.request_for(SIX, "release"), 900.0, lambda: len(heard) == 2)
    assert [one.age for one in heard] == [0.0, 600.0]
    assert getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC) == asking._CLOCK


def test_what_a_robot_says_cannot_steer_the_terminal_that_shows_it() -> None:
    said = OperatorReply(robot="robot1", ok=False, mode="stop", reason="\x1b[2J\x1b]0;all obey\x07no\n")
    rude = Reply("robot1/order", order.encode(said), 2.0)
    outcome = asking.ask(Fleet(robot1=[[rude]]).put, Asked(("robot1",)), STOP, 10.0)
    first, *_ = outcome.words().splitlines()
    assert "REFUSED" in first
    assert first.isprintable()


class Robots:
    """A leader and robots that answer each question at once."""

    def __init__(self, *names: str) -> None:
        self.rests = {name: Rest() for name in names}
        self.heard: list[OperatorRequest] = []
        self.silent: set[str] = set()
        self.between: Callable[[], None] = lambda: None
        """Happens once everybody has said what is in force."""

    def put(self, _key: str, payload: bytes, _timeout: float) -> Question:
        request, question = order.decode(OperatorRequest, payload), Question()
        if self.heard and self.heard[-1].do == "query" != request.do:
            self.between()
        self.heard.append(request)
        for name, rest in self.rests.items():
            if name in self.silent:
                continue
            if request.do == "query":
                said = OperatorReply(robot=name, ok=True, mode="hold", stop=rest.stop, hold=rest.hold)
            else:
                result = rest.change(request, request.id)
                said = OperatorReply(robot=name, ok=result.ok, mode=rest.mode or "run", code=result.code)
            question.replies.append(Reply(f"{name}/order", order.encode(said), 1.0))
        question.end()
        return question

    def give(self, do: str, *, seconds: float = 3.0) -> Outcome:
        first, *others = self.rests
        request = asking.request_for(SIX, do)
        return asking.give(self.put, Asked((first,), tuple(others)), request, seconds)

    @property
    def modes(self) -> list[Mode | None]:
        return [rest.mode for rest in self.rests.values()]


def test_release_names_stops_and_run_names_holds() -> None:
    robots = Robots("leader", "a", "b")
    for do, mode in (("hold", "hold"), ("stop", "stop"), ("release", "hold"), ("run", None)):
        assert robots.give(do).obeyed
        assert robots.modes == [mode] * 3
    assert [one.do for one in robots.heard] == ["hold", "stop", "query", "release", "query", "run"]


def test_a_second_release_sets_no_robot_going() -> None:
    robots = Robots("leader", "a", "b")
    for do in ("hold", "stop"):
        robots.give(do)
    robots.silent = {"b"}
    assert robots.give("release", seconds=0.3).missing == ["b"]
    robots.silent = set()
    again = robots.give("release")
    assert (again.obeyed, again.nothing) == (True, ["leader", "a"])
    assert robots.modes == ["hold"] * 3


def test_a_release_leaves_the_hold_of_a_leader_that_missed_the_stop() -> None:
    robots = Robots("leader", "a")
    robots.give("hold")
    robots.silent = {"leader"}
    robots.give("stop", seconds=0.3)
    robots.silent = set()
    assert robots.give("release").nothing == ["leader"]
    assert robots.modes == ["hold", "hold"]


@pytest.mark.parametrize(("rest", "go"), [("stop", "release"), ("hold", "run")])
def test_a_rest_after_the_query_is_not_ended(rest: Do, go: str) -> None:
    robots = Robots("leader", "a")
    robots.give(rest)

    def newer() -> None:
        for one in robots.rests.values():
            one.change(OperatorRequest(do=rest, id="newer"), "newer")

    robots.between = newer
    assert robots.give(go).refused == ["leader", "a"]
    assert robots.modes == [rest, rest]


def test_what_ends_nothing_is_not_preceded_by_a_query() -> None:
    robots = Robots("leader", "a")
    for do in ("stop", "hold"):
        robots.give(do)
    assert [one.do for one in robots.heard] == ["stop", "hold"]


def test_a_release_that_nobody_answers_is_not_put() -> None:
    robots = Robots("leader", "a")
    robots.silent = {"leader", "a"}
    outcome = robots.give("release", seconds=2.0)
    assert (outcome.missing, outcome.answers) == (["leader", "a"], {})
    assert {one.do for one in robots.heard} == {"query"}
