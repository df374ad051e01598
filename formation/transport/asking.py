"""An operator's word to robots: put to each until it has answered.

The command line and the live page give their orders through this and nothing else.

A question is put again and again without waiting for the answers to the one before, so each robot hears it as
soon as it is linked: nobody waits for one that cannot be reached, or that is linked and says nothing.
"""

from __future__ import annotations

import secrets
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol, get_args

from pydantic import ValidationError

from formation import intent, order
from formation.mission import Mission
from formation.order import MAX_ENDED, MAX_REQUEST, TAKES, Do, OperatorReply, OperatorRequest
from formation.outcome import Answer, Asked, Outcome
from formation.topics import ORDER
from formation.transport.question import Reply
from formation.wire import BadMessage

OPERATOR = "operator"
"""What whoever gives orders is called, in certificates too."""
EVERYONE = ("stop", "hold", "release", "run")
"""Told to each robot directly; all else is the leader's, whose order travels with the positions."""
ENDING = ("release", "run")
"""These name what they end, so that is asked for first."""
LEARNING = 1.0
"""How long all have to say what is in force, once somebody has [s]."""
ROUND = 0.5
"""How long a question waits for its answer before it is put again [s]."""
AGAIN = 0.02
"""When a question is put again that reached nobody, or was answered by one who does not lead [s]."""
LONGEST_PAUSE = 0.05
"""So soon another follows one that somebody has not answered [s]."""
LINKING_PAUSE = 0.12
"""The same where links are counted: questions put while links are being made slow the linking [s]."""
LINKED_FOR = 0.03
"""Where no link has been added for so long, those that there are count as all that can be made [s]."""
LOOK = 0.002
"""How often we look for answers [s]; each has the time at which it came."""
LINGER = 0.1
"""How long the others who may lead have to answer once all that count have [s]."""
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Goes on while a laptop sleeps, so that what it puts after that is as old as it is."""


class Question(Protocol):
    """One that was put: `formation.transport.question.Question`."""

    @property
    def replies(self) -> Sequence[Reply]:
        """Those that have come so far."""

    @property
    def over(self) -> bool:
        """Whether no more will come."""


Put = Callable[[str, bytes, float], Question]
"""`formation.transport.bus.Bus.question`."""


def addressed(mission: Mission, do: str) -> Asked:
    """Who is asked to `do` it."""
    return Asked(mission.candidates, mission.followers if do in EVERYONE else ())


def request_for(mission: Mission, do: str, **what: Any) -> OperatorRequest:
    """A request with an id of its own. Raises ValueError for what cannot be asked; it names what can be.

    `what` belongs to it, as `formation.order.TAKES` has it. Who leads may refuse more: he knows the figure.
    """
    legal = [one for one in get_args(Do) if one != "query"]
    if do not in legal:
        raise ValueError(f"{do!r}: must be one of {', '.join(legal)}")
    what, takes = {name: value for name, value in what.items() if value is not None}, TAKES.get(do, ())
    for name in what:
        if name not in takes:
            raise ValueError(f"{do}: takes no {name}")
    if do == "shape" and not what.get("shape"):
        raise ValueError(f"shape: must be one of {', '.join(mission.shapes)}")
    try:
        request = OperatorRequest.model_validate({"do": do, **what, "id": secrets.token_hex(8)})
    except ValidationError as error:
        raise ValueError(f"{do}: {_plain(error)}") from None
    if why := intent.refusal(mission, request):
        raise ValueError(why)
    if len(order.encode(request)) > MAX_REQUEST:
        raise ValueError(f"{do}: too long, at most {MAX_REQUEST} bytes are sent")
    return request


def give(
    put: Put,
    asked: Asked,
    request: OperatorRequest,
    seconds: float,
    over: Callable[[], bool] = lambda: False,
    linked: Callable[[], int] | None = None,
) -> Outcome:
    """Give an order as `ask` does; one that ends a stop or a hold first learns which are in force.

    A robot that does not say so in time may have another one, and then keeps it. That a stop never waits for
    this costs a release at most `LEARNING` more.
    """
    if request.do not in ENDING:
        return ask(put, asked, request, seconds, over, linked)
    query, began = OperatorRequest(do="query"), _now()
    known = ask(put, asked, query, min(LEARNING, seconds), over, linked)
    while not (known.answers or over() or _now() - began >= seconds):
        known = ask(put, asked, query, min(LEARNING, seconds), over, linked)
    if over() or not known.answers:
        return Outcome(request, asked, {}, known.at, seconds)
    field = "stop" if request.do == "release" else "hold"
    ids = Counter(getattr(answer.reply, field) for answer in known.answers.values())
    ends = tuple(name for name, _ in ids.most_common() if name)[:MAX_ENDED]
    return ask(put, asked, request.model_copy(update={"ends": ends}), seconds, over, linked)


def ask(
    put: Put,
    asked: Asked,
    request: OperatorRequest,
    seconds: float,
    over: Callable[[], bool] = lambda: False,
    linked: Callable[[], int] | None = None,
) -> Outcome:
    """Ask until everybody who counts has answered, for at most `seconds`; what came of it.

    A question reaches who is linked at that moment, and links take a moment, so it is put again and again:
    by its id it is known as the same. Once it is `over` it is not put any more. `linked` counts the robots
    that are linked; a question to all then waits for the first link, and is repeated when all are linked.
    """
    began, outcome = _now(), Outcome(request, asked, {}, time.time(), seconds)
    talks = {key: _Talk(len(asked.names), linked if asked.each else None) for key in _keys(asked)}
    settled = None
    while True:
        age = _now() - began
        for talk in talks.values():
            for question, put_at in talk.open():
                _take(outcome, question.replies, put_at)
        if settled is None and not outcome.missing:
            settled = age
        if outcome.whole or age >= seconds or over() or (settled is not None and age >= settled + LINGER):
            return outcome
        wanted = _keys(asked, outcome.unsettled)
        for key, talk in talks.items():
            if key in wanted and talk.due(age):
                talk.put(put(key, _aged(request, age), min(seconds - age, ROUND)), age)
        time.sleep(LOOK)


def _keys(asked: Asked, of: Sequence[str] | None = None) -> list[str]:
    """What to put a question on: one for everybody, or one for each of who may lead.

    Not one for each of many: a robot whose link is being made is sent all of them, and its Zenoh answers what
    is not for it on the very thread that sends, which a burst stops for seconds.
    """
    if asked.each:
        return [ORDER.pattern.format(robot="*")]
    return [ORDER.key(name) for name in (asked.candidates if of is None else of)]


class _Talk:
    """The questions on one key.

    That one is not over does not mean that all have heard it: it may wait for somebody whose link is half
    made. So another follows soon, and then less often.
    """

    def __init__(self, expected: int, linked: Callable[[], int] | None) -> None:
        """`expected` is how many answer on the key; `linked` counts the links, None where it is not known."""
        self._open: list[tuple[Question, float]] = []
        self._newest, self._pause = -LINKING_PAUSE, AGAIN
        self._expected, self._linked = expected, linked
        self._reached = 0  # links that there were when the newest question was put,
        self._count, self._grew = 0, 0.0  # that there are, and when the newest of them was added [s]

    def due(self, age: float) -> bool:
        """Whether to ask (again), so long [s] after the first question to anybody."""
        if self._linked is not None:
            return self._due_by_links(self._linked(), age)
        heard_by_nobody = all(question.over for question, _ in self._open)
        return age >= self._newest + (AGAIN if heard_by_nobody else self._pause)

    def _due_by_links(self, count: int, age: float) -> bool:
        """At the first link, when no more are being made, and every `LINKING_PAUSE`."""
        if count > self._count:
            self._grew = age
        self._count = count
        complete = count >= self._expected or age >= self._grew + LINKED_FOR
        added = self._reached == 0 or (count > self._reached and complete)
        due = count > 0 and (added or age >= self._newest + LINKING_PAUSE)
        if due:
            self._reached = count
        return due

    def put(self, question: Question, age: float) -> None:
        """It was asked."""
        self._pause = min(2.0 * self._pause, LONGEST_PAUSE) if self._open else 2.0 * AGAIN
        self._open.append((question, age))
        self._newest = age

    def open(self) -> list[tuple[Question, float]]:
        """Questions and when they were put; each is there once more after it is over."""
        told, self._open = self._open, [one for one in self._open if not one[0].over]
        return told


def _take(outcome: Outcome, replies: Sequence[Reply], put_at: float) -> None:
    """Keep the first answer of each; of whoever may lead, the first in which it leads."""
    for said, ms in _read(replies):
        known = outcome.answers.get(said.robot)
        waits = known is not None and known.reply.leads is False and said.leads is not False
        if said.robot in outcome.asked.names and (known is None or waits):
            outcome.answers[said.robot] = Answer(said, put_at * 1e3 + ms)


def _plain(error: ValidationError) -> str:
    first = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    said = first["msg"].replace("Input should be", "must be")
    return f"{where} = {first['input']!r}: {said}" if where else said


def _now() -> float:
    return time.clock_gettime(_CLOCK)


def _aged(request: OperatorRequest, age: float) -> bytes:
    """The request as it is put when it is so old [s]: what is put again is older than 0, by `AGAIN` at least.

    Who has obeyed a stop does so again only if it is new; who has not, however old it is.
    """
    return order.encode(request.model_copy(update={"age": round(age, 2)}))


def _read(replies: Sequence[Reply]) -> Iterator[tuple[OperatorReply, float]]:
    for reply in list(replies):  # more may come meanwhile
        try:
            said = order.decode(OperatorReply, reply.payload)
        except BadMessage:
            continue  # whoever says that is no robot of ours
        if reply.key == ORDER.key(said.robot):
            reason = "".join(c if c.isprintable() else " " for c in said.reason)  # it goes to terminals
            yield said.model_copy(update={"reason": reason}), reply.ms
