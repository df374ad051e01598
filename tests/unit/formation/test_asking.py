"""Operator requests: recipients, repetition and end."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any, get_args

import pytest

from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.order import Mode
from formation.protocol.outcome import Outcome, Recipients
from formation.protocol.request import Do, OperatorReply, OperatorRequest, ReplyCode
from formation.protocol.stops import MOTION, Rest
from formation.stability import intent
from formation.transport import asking
from formation.transport.mailbox import Question, Reply

SIX = load("six_robots")


class Clock:
    """Replaces `time`; advances only in `sleep`."""

    def __init__(self) -> None:
        self.now = 0.0
        """[s]"""

    def time(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Replace the clock of `asking`, so that no time depends on the load of the machine."""
    clock = Clock()
    monkeypatch.setattr(asking, "_now", clock.time)
    monkeypatch.setattr(asking, "time", clock)
    return clock


def reply(robot: str, *, ok: bool = True, mode: Mode = "stop", key: str = "", **fields: Any) -> Reply:
    output = OperatorReply(robot=robot, ok=ok, mode=mode, **fields)
    return Reply(key or f"{robot}/order", json_message.encode(output), 1.5)


class Fleet:
    """Answers each question with the next list of replies for its key; repeats the last list.

    If `silent`, one linked robot never answers, so questions to all end only by timeout.
    """

    def __init__(self, *, silent: bool = False, **rounds: Sequence[Sequence[Reply]]) -> None:
        self.rounds = {name: list(one) for name, one in rounds.items()}
        self.put_to: list[str] = []
        self.put_at: list[float] = []
        self.received: list[OperatorRequest] = []
        self.silent = silent

    def put(self, key: str, payload: bytes, timeout: float) -> Question:
        assert 0.0 < timeout <= asking.MAX_ROUND_TIME
        self.received.append(json_message.decode(OperatorRequest, payload))
        question, name = Question(), key.removesuffix("/order").replace("*", "all")
        self.put_to.append(name)
        self.put_at.append(asking._now())
        rounds = self.rounds.get(name, [[]])
        question.replies += rounds.pop(0) if len(rounds) > 1 else rounds[0]
        if not self.silent:
            question.end()
        return question

    def ask(
        self, do: Do = "stop", candidates: str = "robot1", each: str = "", seconds: float = 10.0, **more: Any
    ) -> Outcome:
        recipients = Recipients(tuple(candidates.split()), tuple(each.split()))
        return asking.ask(self.put, recipients, OperatorRequest(do=do), seconds, **more)


def test_question_is_repeated_until_all_answer_and_first_answer_counts() -> None:
    one, two = reply("robot1"), reply("robot2")
    fleet = Fleet(all=[[two], [], [reply("robot2", mode="hold"), one], [one]])
    outcome = fleet.ask(each="robot2")
    assert outcome.obeyed
    assert fleet.put_to == ["all"] * 3
    assert outcome.answers["robot2"].reply.mode == "stop"
    assert outcome.answers["robot2"].ms == pytest.approx(1.5, abs=1.0)  # since the first question
    assert outcome.answers["robot1"].ms > 2e3 * asking.REPEAT_PAUSE


@pytest.mark.parametrize("ok", [True, False])
@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("readonly_first", [True, False])
def test_answer_of_commanding_agent_outranks_readonly_agent(
    *, ok: bool, rounds: int, readonly_first: bool
) -> None:
    """The readonly agent answers before or after it, with the opposite verdict."""
    answers = [reply("robot2", ok=ok), reply("robot2", ok=not ok, readonly=True)]
    first, second = reversed(answers) if readonly_first else answers
    given = [[first, second]] if rounds == 1 else [[first], [second]]
    given[0].insert(0, reply("robot1"))
    outcome = Fleet(all=given).ask(each="robot2")
    assert (outcome.answers["robot2"].reply.readonly, outcome.obeyed) == (False, ok)


def test_answer_of_readonly_agent_alone_counts(clock: Clock) -> None:
    answers = [reply("robot1"), reply("robot2", ok=False, readonly=True)]
    assert Fleet(all=[answers]).ask(each="robot2").refused == ["robot2"]
    assert clock.now < 0.2


@pytest.mark.parametrize("rounds", [1, 2])
@pytest.mark.parametrize("refusal_first", [True, False])
def test_refusing_one_of_two_commanding_agents_counts(*, rounds: int, refusal_first: bool) -> None:
    answers = [reply("robot2"), reply("robot2", ok=False, mode="run", code="no-link")]
    first, second = reversed(answers) if refusal_first else answers
    given = [[first, second, reply("robot1")]] if rounds == 1 else [[first], [second, reply("robot1")]]
    outcome = Fleet(all=given).ask(each="robot2")
    assert (outcome.unreached, outcome.obeyed) == (["robot2"], False)
    assert "1 of 2 obey" in outcome.summary()
    assert "NOT STOPPED: robot2: use the robot's own switch" in outcome.summary()


def test_refusal_shortly_after_all_have_answered_counts(clock: Clock) -> None:
    question = Question()

    def put(*_: Any) -> Question:
        question.add_reply("robot1/order", reply("robot1").payload)
        return question

    def over() -> bool:
        if clock.now >= 0.5 * asking.LINGER_TIME and not question.over:
            question.add_reply("robot1/order", reply("robot1", ok=False, code="no-link").payload)
            question.end()
        return False

    outcome = asking.ask(put, Recipients(("robot1",)), OperatorRequest(do="stop"), 10.0, over)
    assert outcome.refused == ["robot1"]
    assert clock.now < asking.LINGER_TIME


def test_linked_but_silent_robot_delays_no_other() -> None:
    fleet = Fleet(all=[[reply("robot1")], [], [], [reply("robot3")]], silent=True)
    outcome = fleet.ask(each="robot2 robot3", seconds=0.4)
    assert outcome.missing == ["robot2"]
    assert len(fleet.put_to) > 0.7 * 0.4 / asking.LONGEST_PAUSE
    assert outcome.answers["robot3"].ms < 1e3 * asking.MAX_ROUND_TIME


def test_late_answer_to_earlier_question_counts() -> None:
    questions: list[Question] = []

    def put(*_: Any) -> Question:
        questions.append(Question())
        if len(questions) == 3:
            questions[0].replies.append(reply("robot1"))
        return questions[-1]

    assert asking.ask(put, Recipients(("robot1",)), OperatorRequest(do="stop"), 10.0).obeyed


def test_invalid_or_foreign_answers_do_not_count() -> None:
    strange = [Reply("robot1/order", b"yes", 1.0), reply("robot9"), reply("robot2", key="robot1/order")]
    assert Fleet(all=[strange]).ask(each="robot2", seconds=0.05).answers == {}


def test_question_to_all_waits_for_links(clock: Clock) -> None:
    """One question at the first link and one when all are linked, no others."""
    both = [reply("robot1"), reply("robot2")]
    fleet = Fleet(all=[both[:1], both])
    outcome = fleet.ask(each="robot2", linked=lambda: (clock.now >= 0.05) + (clock.now >= 0.10))
    assert outcome.obeyed
    assert fleet.put_at == pytest.approx([0.05, 0.10], abs=2 * asking.CHECK_PERIOD)


def test_question_to_all_is_repeated_while_a_link_is_missing() -> None:
    fleet = Fleet(all=[[reply("robot1")]])
    assert fleet.ask(each="robot2", seconds=1.0, linked=lambda: 1).missing == ["robot2"]
    assert len(fleet.put_to) == pytest.approx(1.0 / asking.LINKING_PAUSE, abs=1.0)


def test_question_is_not_repeated_once_over_returns_true() -> None:
    fleet = Fleet(all=[[reply("robot1")]])
    assert not fleet.ask(each="robot2", over=lambda: len(fleet.put_to) >= 5).obeyed
    assert len(fleet.put_to) == 5


def test_standby_is_asked_again_until_it_leads() -> None:
    waits, leads = reply("robot2", leads=False), reply("robot2", leads=True)
    fleet = Fleet(robot2=[[waits], [waits], [leads]])
    outcome = fleet.ask("run", "robot1 robot2")
    assert (outcome.leader, outcome.obeyed) == ("robot2", True)
    assert fleet.put_to.count("robot2") == 3


def test_answer_of_leading_process_outranks_other_of_same_name() -> None:
    both = [reply("robot1", leads=False), reply("robot1", leads=True, mode="hold")]
    assert Fleet(robot1=[both]).ask("hold").answers["robot1"].reply.mode == "hold"


def test_dead_candidate_does_not_delay_the_outcome(clock: Clock) -> None:
    fleet = Fleet(robot2=[[reply("robot2", leads=True)]], robot3=[[], [], [reply("robot3", leads=False)]])
    outcome = fleet.ask("run", "robot1 robot2 robot3")
    assert clock.now < 5.0
    assert (outcome.obeyed, outcome.standby) == (True, ["robot3"])


@pytest.mark.parametrize("do", get_args(Do))
def test_only_motion_requests_are_addressed_to_all_followers(do: Do) -> None:
    mission = Mission.model_validate({**SIX.model_dump(), "standbys": {"second": {}, "third": {}}})
    recipients = asking.addressed(mission, do)
    assert recipients.candidates == ("robot1", "second", "third")
    assert recipients.each == (mission.followers if do in MOTION else ())


def test_repeated_request_carries_its_age() -> None:
    fleet = Fleet()
    fleet.ask("release", seconds=0.2)
    ages = [one.age for one in fleet.received]
    assert ages[0] == 0.0 < ages[1]
    assert ages[-1] > 0.1
    assert ages == sorted(ages)
    # a clock that advances while the computer is suspended
    assert getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC) == asking._CLOCK


def test_refusal_reason_is_printed_without_control_characters() -> None:
    rude = reply("robot1", ok=False, reason="\x1b[2J\x1b]0;all obey\x07no\n")
    first, *_ = Fleet(robot1=[[rude]]).ask().words().splitlines()
    assert "REFUSED" in first
    assert first.isprintable()


class Robots:
    """A leader and robots that answer each question at once."""

    def __init__(self, *names: str) -> None:
        self.rests = {name: Rest() for name in names}
        self.received: list[OperatorRequest] = []
        self.silent: set[str] = set()
        self.strangers: set[str] = set()
        """Robots of another mission."""
        self.between: Callable[[], None] = lambda: None
        """Called between the query and the request after it."""

    def put(self, _key: str, payload: bytes, _timeout: float) -> Question:
        request, question = json_message.decode(OperatorRequest, payload), Question()
        if self.received and self.received[-1].do == "query" != request.do:
            self.between()
        self.received.append(request)
        for name, rest in self.rests.items():
            if name in self.silent:
                continue
            if request.do == "query":
                code: ReplyCode = "other-mission" if name in self.strangers and request.mission else ""
                answer = reply(name, mode="hold", stop=rest.stop, hold=rest.hold, code=code)
            else:
                result = rest.change(request, request.id)
                answer = reply(name, ok=result.ok, mode=rest.mode or "run", code=result.code)
            question.replies.append(answer)
        question.end()
        return question

    def give(self, do: str, *, seconds: float = 3.0) -> Outcome:
        first, *others = self.rests
        request = intent.request_for(SIX, do)
        return asking.give(self.put, Recipients((first,), tuple(others)), request, seconds)

    @property
    def modes(self) -> list[Mode | None]:
        return [rest.mode for rest in self.rests.values()]


def test_release_and_run_are_preceded_by_a_query() -> None:
    robots = Robots("leader", "a", "b")
    for do, mode in (("hold", "hold"), ("stop", "stop"), ("release", "hold"), ("run", None)):
        assert robots.give(do).obeyed
        assert robots.modes == [mode] * 3
    assert [one.do for one in robots.received] == [
        "hold", "query", "stop", "query", "query", "release", "query", "run"
    ]  # fmt: skip


def test_stop_names_no_mission_and_is_followed_by_query() -> None:
    robots = Robots("leader", "a", "b")
    robots.strangers, robots.silent = {"a"}, {"leader"}
    outcome = robots.give("stop", seconds=0.3)
    assert {(one.do, one.mission) for one in robots.received} == {("stop", ""), ("query", SIX.tag)}
    assert (outcome.elsewhere, outcome.missing, outcome.obeyed) == (["a"], ["leader"], False)
    assert robots.modes == [None, "stop", "stop"]
    assert "another mission runs at a: name that one" in outcome.words()
    assert outcome.report()["mission"] == SIX.tag


def test_unanswered_stop_asks_for_no_mission() -> None:
    robots = Robots("leader", "a")
    robots.silent = {"leader", "a"}
    assert robots.give("stop", seconds=0.3).elsewhere == []
    assert {one.do for one in robots.received} == {"stop"}


def test_repeated_release_leaves_all_robots_held() -> None:
    robots = Robots("leader", "a", "b")
    for do in ("hold", "stop"):
        robots.give(do)
    robots.silent = {"b"}
    assert robots.give("release", seconds=0.3).missing == ["b"]
    robots.silent = set()
    again = robots.give("release")
    assert (again.obeyed, again.nothing) == (True, ["leader", "a"])
    assert robots.modes == ["hold"] * 3


@pytest.mark.parametrize(("rest", "go"), [("stop", "release"), ("hold", "run")])
def test_stop_or_hold_newer_than_query_is_not_ended(rest: Do, go: str) -> None:
    robots = Robots("leader", "a")
    robots.give(rest)

    def newer() -> None:
        for one in robots.rests.values():
            one.change(OperatorRequest(do=rest, id="newer"), "newer")

    robots.between = newer
    assert robots.give(go).refused == ["leader", "a"]
    assert robots.modes == [rest, rest]


def test_unanswered_query_prevents_release() -> None:
    robots = Robots("leader", "a")
    robots.silent = {"leader", "a"}
    outcome = robots.give("release", seconds=2.0)
    assert (outcome.missing, outcome.answers) == (["leader", "a"], {})
    assert {one.do for one in robots.received} == {"query"}
