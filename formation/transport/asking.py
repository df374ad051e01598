"""An operator's request to robots, repeated to each until it has answered.

The command line and the live page send their requests only through this module.

A question is repeated without waiting for the answers to the one before, so each robot receives it as soon
as it is linked: no robot waits for one that is unreachable or silent.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Protocol

from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.outcome import Answer, Outcome, Recipients
from formation.protocol.request import MAX_ENDED, OperatorReply, OperatorRequest
from formation.protocol.stops import RESTS
from formation.topics import ORDER
from formation.transport.mailbox import Reply
from formation.wire import BadMessage

OPERATOR = "operator"
"""Name of the operator, in certificates too."""
EVERYONE = ("stop", "hold", "release", "run")
"""Requests sent to each robot directly; all others go to the leader, which puts them into its orders."""
ENDING = ("release", "run")
"""Requests that name what they end, so that is queried first."""
LEARNING_TIME = 1.0
"""Time for all robots to report what is in force, after the first has [s]."""
MISSION_TIME = 0.3
"""Time for robots to report whether they run the mission that was named [s]."""
MAX_ROUND_TIME = 0.5
"""Longest wait of a question for its answer before it is repeated [s]."""
REPEAT_PAUSE = 0.02
"""Time after which a question is repeated that reached no robot, or only standbys [s]."""
LONGEST_PAUSE = 0.05
"""Longest time after which an unanswered question is repeated [s]."""
LINKING_PAUSE = 0.12
"""The same if links are counted: questions sent while links are being made slow the linking [s]."""
LINKS_STABLE_TIME = 0.03
"""Time without a new link after which the existing ones count as all [s]."""
CHECK_PERIOD = 0.002
"""Period of checks for answers [s]; each has its own time of arrival."""
LINGER_TIME = 0.1
"""Time for the other candidates to answer after all required robots have [s]."""
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Continues while a laptop sleeps, so that the age of a later request is right."""


class Question(Protocol):
    """A question that was sent: `formation.transport.mailbox.Question`."""

    @property
    def replies(self) -> Sequence[Reply]:
        """Answers so far."""

    @property
    def over(self) -> bool:
        """Whether no more answers will come."""


Put = Callable[[str, bytes, float], Question]
"""`formation.transport.bus.Bus.question`."""


def addressed(mission: Mission, do: str) -> Recipients:
    """The processes that must answer the request `do`."""
    return Recipients(mission.candidates, mission.followers if do in EVERYONE else ())


def give(
    put: Put,
    recipients: Recipients,
    request: OperatorRequest,
    seconds: float,
    over: Callable[[], bool] = lambda: False,
    linked: Callable[[], int] | None = None,
) -> Outcome:
    """Send a request as `ask` does; one that ends a stop or a hold first queries which are in force.

    A robot that does not report it in time may have another one, and then keeps it. A stop never waits for
    this; a release takes at most `LEARNING_TIME` longer. Robots are asked after a stop or a hold whether they
    run the mission of the request, for at most `MISSION_TIME`.
    """
    if request.do in RESTS:
        outcome = ask(put, recipients, request.model_copy(update={"mission": ""}), seconds, over, linked)
        return outcome._replace(request=request, strangers=_strangers(put, outcome, request.mission, over))
    if request.do not in ENDING:
        return ask(put, recipients, request, seconds, over, linked)
    query, began = OperatorRequest(do="query"), _now()
    while True:
        known = ask(put, recipients, query, min(LEARNING_TIME, seconds), over, linked)
        if known.answers or over() or _now() - began >= seconds:
            break
    if over() or not known.answers:
        return Outcome(request, recipients, {}, known.at, seconds)
    field = "stop" if request.do == "release" else "hold"
    ids = Counter(getattr(answer.reply, field) for answer in known.answers.values())
    ends = tuple(name for name, _ in ids.most_common() if name)[:MAX_ENDED]
    return ask(put, recipients, request.model_copy(update={"ends": ends}), seconds, over, linked)


def _strangers(put: Put, outcome: Outcome, mission: str, over: Callable[[], bool]) -> frozenset[str]:
    """Return the robots that answered and run another mission than the one with this tag."""
    if not mission or not outcome.answers or over():
        return frozenset()
    query = OperatorRequest(do="query", mission=mission)
    known = ask(put, outcome.recipients, query, MISSION_TIME, over)
    return frozenset(name for name, one in known.answers.items() if one.reply.code == "other-mission")


def ask(
    put: Put,
    recipients: Recipients,
    request: OperatorRequest,
    seconds: float,
    over: Callable[[], bool] = lambda: False,
    linked: Callable[[], int] | None = None,
) -> Outcome:
    """Ask until all required robots have answered, for at most `seconds`; return the result.

    A question reaches the robots linked at that moment, and linking takes a moment, so it is repeated: its
    id identifies it. After `over` it is not repeated. `linked` counts the linked robots; a question to all
    then waits for the first link, and is repeated when all are linked. After a stop or a hold, further
    answers to the questions sent so far are awaited for `LINGER_TIME`.
    """
    began, outcome = _now(), Outcome(request, recipients, {}, time.time(), seconds)
    counted = linked if recipients.each else None
    talks = {key: _Talk(len(recipients.names), counted) for key in _keys(recipients)}
    settled = None
    resting = request.do in RESTS
    while True:
        age = _now() - began
        for talk in talks.values():
            for question, put_at in talk.open():
                _take(outcome, question.replies, put_at)
        if settled is None and not outcome.missing:
            settled = age
        lingered = settled is not None and age >= settled + LINGER_TIME
        # a second agent of a robot may still answer that it does not stand
        complete = outcome.whole and not (resting and any(talk.waits for talk in talks.values()))
        if complete or lingered or age >= seconds or over():
            return outcome
        wanted = [] if outcome.whole else _keys(recipients, outcome.unsettled)
        for key, talk in talks.items():
            if key in wanted and talk.due(age):
                # a repeated request is older than 0, by `REPEAT_PAUSE` at least: a robot that has obeyed a
                # stop does so again only if it is new; another one, however old it is
                aged = json_message.encode(request.model_copy(update={"age": round(age, 2)}))
                talk.put(put(key, aged, min(seconds - age, MAX_ROUND_TIME)), age)
        time.sleep(CHECK_PERIOD)


def drive(put: Put, mission: Mission, request: OperatorRequest, seconds: float) -> OperatorReply | None:
    """Send a driver's velocity to all candidates; return the leader's answer, None after `seconds`."""
    began, payload = _now(), json_message.encode(request)
    questions = [put(ORDER.key(name), payload, seconds) for name in mission.candidates]
    while _now() - began < seconds:
        for reply in [one for question in questions for one in list(question.replies)]:
            try:
                answer = json_message.decode(OperatorReply, reply.payload)
            except BadMessage:
                continue
            if answer.leads and answer.robot in mission.candidates:
                return answer
        if all(question.over for question in questions):
            return None
        time.sleep(CHECK_PERIOD)
    return None


def _keys(recipients: Recipients, of: Sequence[str] | None = None) -> list[str]:
    """Keys of a question: one for all robots, or one for each candidate.

    Not one for each of many: a robot with an unfinished link is sent all of them, and its Zenoh answers
    those for others on the sending thread, which a burst blocks for seconds.
    """
    if recipients.each:
        return [ORDER.pattern.format(robot="*")]
    return [ORDER.key(name) for name in (recipients.candidates if of is None else of)]


class _Talk:
    """The questions on one key.

    An unfinished one need not have reached all: it may wait for a robot with an unfinished link. So
    another follows soon, and then less often.
    """

    def __init__(self, expected: int, linked: Callable[[], int] | None) -> None:
        """`expected` is the number of answers on the key; `linked` counts the links, None if unknown."""
        self._open: list[tuple[Question, float]] = []
        self._newest, self._pause = -LINKING_PAUSE, REPEAT_PAUSE
        self._expected, self._linked = expected, linked
        self._reached = 0  # links when the newest question was sent,
        self._count, self._grew = 0, 0.0  # present links, and when the newest of them was added [s]

    def due(self, age: float) -> bool:
        """Whether to ask (again), at this time [s] after the first question of the request."""
        if self._linked is not None:
            return self._due_by_links(self._linked(), age)
        all_over = all(question.over for question, _ in self._open)
        return age >= self._newest + (REPEAT_PAUSE if all_over else self._pause)

    def _due_by_links(self, count: int, age: float) -> bool:
        """At the first link, when links are complete, and every `LINKING_PAUSE`."""
        if count > self._count:
            self._grew = age
        self._count = count
        complete = count >= self._expected or age >= self._grew + LINKS_STABLE_TIME
        added = self._reached == 0 or (count > self._reached and complete)
        due = count > 0 and (added or age >= self._newest + LINKING_PAUSE)
        if due:
            self._reached = count
        return due

    def put(self, question: Question, age: float) -> None:
        """Record that it was sent."""
        self._pause = min(2.0 * self._pause, LONGEST_PAUSE) if self._open else 2.0 * REPEAT_PAUSE
        self._open.append((question, age))
        self._newest = age

    @property
    def waits(self) -> bool:
        """Whether any of them may still be answered."""
        return bool(self._open)

    def open(self) -> list[tuple[Question, float]]:
        """Questions and when they were sent; each is returned once more after it is over."""
        questions, self._open = self._open, [one for one in self._open if not one[0].over]
        return questions


def _take(outcome: Outcome, replies: Sequence[Reply], put_at: float) -> None:
    """Keep one answer of each robot: the first of those with the highest rank."""
    for reply in list(replies):  # more may arrive meanwhile
        try:
            new = json_message.decode(OperatorReply, reply.payload)
        except BadMessage:
            continue  # not an answer of our robots
        if reply.key != ORDER.key(new.robot) or new.robot not in outcome.recipients.names:
            continue
        known = outcome.answers[new.robot].reply if new.robot in outcome.answers else None
        if known is None or _rank(new) > _rank(known):
            # it is printed in terminals
            reason = "".join(c if c.isprintable() else " " for c in new.reason)
            answer = Answer(new.model_copy(update={"reason": reason}), put_at * 1e3 + reply.ms)
            outcome.answers[new.robot] = answer


def _rank(reply: OperatorReply) -> tuple[bool, bool, bool]:
    """Of two agents one that commands outranks, then one that leads, then one that does not obey."""
    return not reply.readonly, reply.leads is not False, not reply.ok


def _now() -> float:
    return time.clock_gettime(_CLOCK)
