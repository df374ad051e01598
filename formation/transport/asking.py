"""An operator's word to robots: put until each has answered, and what they answered, for people and programs.

The command line and the live page give their orders through this and nothing else.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, get_args

from formation import order
from formation.mission import Mission
from formation.order import RESTS, Do, OperatorReply, OperatorRequest
from formation.topics import ORDER
from formation.transport.bus import Reply
from formation.wire import BadMessage

OPERATOR = "operator"
"""What whoever gives orders is called, in certificates too."""
EVERYONE = ("stop", "release")
"""Told to each robot directly; all else is the leader's, whose order travels with the positions."""
ROUND = 0.5
"""How long one question waits for all its answers before it is put again [s]."""
Ask = Callable[[str, bytes, float], Sequence[Reply]]
"""`formation.transport.bus.Bus.ask`."""


class Answer(NamedTuple):
    """One robot's answer."""

    reply: OperatorReply
    ms: float
    """Round trip [ms]."""


def addressed(mission: Mission, do: str) -> tuple[str, ...]:
    """Who is asked to `do` it."""
    return mission.names if do in EVERYONE else (mission.leader,)


def request_for(mission: Mission, do: str, shape: str | None = None) -> OperatorRequest:
    """A request with an id of its own. Raises ValueError for what cannot be asked; it names what can be."""
    if do not in get_args(Do):
        raise ValueError(f"{do!r}: must be one of {', '.join(get_args(Do))}")
    if do != "shape" and shape is not None:
        raise ValueError(f"{do}: takes no shape")
    if do == "shape" and shape not in mission.shapes:
        which = "shape" if shape is None else f"shape {shape!r}"
        raise ValueError(f"{which}: must be one of {', '.join(mission.shapes)}")
    return OperatorRequest.model_validate({"do": do, "shape": shape, "id": secrets.token_hex(8)})


def ask(
    put: Ask,
    robots: Sequence[str],
    request: OperatorRequest,
    seconds: float,
    pause: float = 0.02,
    over: Callable[[], bool] = lambda: False,
) -> dict[str, Answer]:
    """Ask `robots` until each has answered, for at most `seconds`; the answers there are, by robot.

    A question reaches who is linked at that moment, and links take a moment, so it is put again and again:
    by its id it is known as the same. Once it is `over` it is not put any more.
    """
    key = ORDER.key(robots[0]) if len(robots) == 1 else ORDER.pattern.format(robot="*")
    answers: dict[str, Answer] = {}
    began, age = time.monotonic(), 0.0
    while (left := began + seconds - time.monotonic()) > 0.0 and not over():
        for name, answer in _read(put(key, _aged(request, age), min(left, ROUND))):
            if name in robots:
                answers.setdefault(name, answer)
        if len(answers) == len(robots):
            break
        time.sleep(pause)
        age = time.monotonic() - began
    return answers


def obeyed(asked: Sequence[str], answers: Mapping[str, Answer]) -> bool:
    """Whether all have."""
    return all(name in answers and answers[name].reply.ok for name in asked)


def report(request: OperatorRequest, asked: Iterable[str], answers: Mapping[str, Answer]) -> dict[str, Any]:
    """The answers for a program."""
    robots = {
        name: {
            "ok": answer.reply.ok,
            "mode": answer.reply.mode,
            "reason": answer.reply.reason,
            "ms": round(answer.ms, 3),
        }
        for name, answer in answers.items()
    }
    missing = [name for name in asked if name not in answers]
    what = request.model_dump(include={"do", "shape"}, exclude_none=True)
    return {**what, "robots": robots, "missing": missing}


def words(
    request: OperatorRequest, asked: Sequence[str], answers: Mapping[str, Answer], seconds: float
) -> str:
    """The answers for people, a robot a line, and what they come to."""
    lines = []
    for name in asked:
        answer = answers.get(name)
        if answer is None:
            text = f"NO ANSWER within {seconds:g} s"
        else:
            verdict = _verdict(request.do, answer.reply)
            text = f"{verdict:<8}{answer.ms:7.1f} ms  {answer.reply.reason}"
        lines.append(f"  {name:<12}{text}".rstrip())
    return "\n".join([*lines, summary(request, asked, answers)])


def summary(request: OperatorRequest, asked: Sequence[str], answers: Mapping[str, Answer]) -> str:
    """What the answers come to, in a line."""
    missing = [name for name in asked if name not in answers]
    agree = sum(answer.reply.ok for answer in answers.values())
    what = request.do if request.shape is None else f"{request.do} {request.shape}"
    line = f"{what}: {agree} of {len(asked)} obey"
    if answers:
        line += f", slowest {max(answer.ms for answer in answers.values()):.0f} ms"
    return f"{line}; no answer from {', '.join(missing)}" if missing else line


def _aged(request: OperatorRequest, age: float) -> bytes:
    """The request as it is put when it is so old [s]; a stop counts however old it is."""
    aged = {} if request.do in RESTS else {"age": round(age, 2)}
    return order.encode(request.model_copy(update=aged))


def _verdict(do: Do, reply: OperatorReply) -> str:
    if not reply.ok:
        return "REFUSED"
    # a robot that was released stands until it hears the leader, and says so
    return "released" if (do, reply.mode) == ("release", "stop") else reply.mode


def _read(replies: Iterable[Reply]) -> Iterable[tuple[str, Answer]]:
    for reply in replies:
        try:
            said = order.decode(OperatorReply, reply.payload)
        except BadMessage:
            continue  # whoever says that is no robot of ours
        if reply.key == ORDER.key(said.robot):
            reason = "".join(c if c.isprintable() else " " for c in said.reason)  # it goes to terminals
            yield said.robot, Answer(said.model_copy(update={"reason": reason}), reply.ms)
