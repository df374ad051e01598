"""Results of an operator's request: asked, obeying and missing robots; for people and for programs.

Of the candidates one leads, and only its answer counts; the others stand by. So a dead leader is missing
only as long as no other one leads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from formation.protocol.request import TAKES, UNREACHED, OperatorReply, OperatorRequest

UNDONE = {"stop": "NOT STOPPED", "hold": "NOT HELD"}
"""Description of a robot that a request does not reach."""


class Answer(NamedTuple):
    """One robot's answer."""

    reply: OperatorReply
    ms: float
    """Time since the first question of the request was sent [ms]."""


class Recipients(NamedTuple):
    """The processes that are asked."""

    candidates: tuple[str, ...]
    """Candidates by rank: the one that leads must answer."""
    each: tuple[str, ...] = ()
    """Robots that must all answer besides."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all of them."""
        return (*self.candidates, *self.each)


class Outcome(NamedTuple):
    """The answers to one request so far."""

    request: OperatorRequest
    recipients: Recipients
    answers: dict[str, Answer]
    at: float
    """When the first question was sent [s, our system clock]."""
    seconds: float
    """Longest wait for answers [s]."""
    strangers: frozenset[str] = frozenset()
    """Robots that were found to run another mission than the one of the request."""

    @property
    def leader(self) -> str | None:
        """The leader, by its own answer."""
        leading = (name for name in self.recipients.candidates if self._leads(name))
        return next(leading, None)

    @property
    def missing(self) -> list[str]:
        """Robots that have not answered; the mission's leader if no candidate answers that it leads."""
        lost = [] if self.leader else [self.recipients.candidates[0]]
        return lost + [name for name in self.recipients.each if name not in self.answers]

    @property
    def standby(self) -> list[str]:
        """Candidates that answer that they do not lead."""
        return [name for name in self.recipients.candidates if name in self.answers and not self._leads(name)]

    @property
    def refused(self) -> list[str]:
        """Robots that answered and do not obey."""
        return [name for name in self._counting if not self.answers[name].reply.ok]

    @property
    def unreached(self) -> list[str]:
        """Robots with a stop or a hold that their agent has latched and that cannot reach the robot."""
        return [name for name in self.refused if self.answers[name].reply.code in UNREACHED]

    @property
    def elsewhere(self) -> list[str]:
        """Robots that run another mission than the one of the request."""
        return [
            name
            for name in self._counting
            if name in self.strangers or self.answers[name].reply.code == "other-mission"
        ]

    @property
    def nothing(self) -> list[str]:
        """Robots that had nothing to release."""
        return [name for name in self._counting if self.answers[name].reply.code == "nothing"]

    @property
    def obeyed(self) -> bool:
        """Whether all required robots obeyed, and run the mission of the request.

        A robot of another mission may have obeyed a stop, but that mission's other robots were not asked.
        """
        return not self.missing and not self.refused and not self.elsewhere

    @property
    def unsettled(self) -> list[str]:
        """Names still to be asked: the silent ones, and those that stand by while there is no leader.

        Also robots for which only an agent that does not command them has answered.
        """
        silent = [
            name
            for name in self.recipients.names
            if name not in self.answers or self.answers[name].reply.readonly
        ]
        return silent if self.leader else silent + self.standby

    @property
    def whole(self) -> bool:
        """Whether all have answered."""
        return not self.unsettled

    def report(self) -> dict[str, Any]:
        """The result for programs."""
        return {
            **{name: value for name, value in self.request.spelled.items() if name != "age"},
            "at": round(self.at, 6),
            "leader": self.leader,
            "acknowledged": [self._result_of(name) for name in self._counting if self.answers[name].reply.ok],
            "refused": [self._result_of(name) for name in self.refused],
            "missing": self.missing,
            "standby": self.standby,
            **({"unreached": self.unreached} if self.request.do in UNDONE else {}),
            "advice": list(self._advice()),
        }

    def words(self) -> str:
        """The result for people: a line for each robot, and a summary."""
        return "\n".join([*self._lines(), self.summary()])

    def summary(self) -> str:
        """Summary of the answers, in a line."""
        counting = self._counting
        agree = len(counting) - len(self.refused)
        line = f"{called(self.request)}: {agree} of {len(self.recipients.each) + 1} obey"
        if counting:
            line += f", slowest {max(self.answers[name].ms for name in counting):.0f} ms"
        if self.missing:
            line += f"; no answer from {', '.join(self.missing)}"
        if not self.leader and self.standby:
            line += f", standby: {', '.join(self.standby)}"
        return "; ".join([line, *self._advice()])

    def _advice(self) -> Iterator[str]:
        do, robots = self.request.do, self._silent_robots
        if self.elsewhere:
            names = ", ".join(self.elsewhere)
            yield f"another mission runs at {names}: name that one, to reach all its robots"
        if do == "stop" and not self.leader and self._counting:
            yield "robots that obey stand, with a leader or without"
        if do in UNDONE and self.unreached:
            yield f"{UNDONE[do]}: {', '.join(self.unreached)}: use the robot's own switch"
        if do in UNDONE and robots:
            yield f"{', '.join(robots)} may still drive: use the robot's own switch"
        yield from self._advice_to_go_on()

    def _advice_to_go_on(self) -> Iterator[str]:
        """Advice after a run or a release."""
        do, robots = self.request.do, self._silent_robots
        if do == "run" and self._stopped:
            yield f"a stop is in force at {', '.join(self._stopped)}: order release, then run"
        if do == "run" and robots:
            yield f"{', '.join(robots)} may still be held: order run again"
        if do == "release":
            if self.nothing:
                yield f"nothing to release at {', '.join(self.nothing)}"
            if len(self.nothing) < len(self._counting) - len(self.refused):
                yield "all robots hold until you order run"
            if robots:
                yield f"{', '.join(robots)} may still be stopped: release again"

    def _lines(self) -> Iterator[str]:
        width = max(12, 2 + max(len(name) for name in self.recipients.names))
        for name in self.recipients.names:
            answer = self.answers.get(name)
            if answer is None and name in self.recipients.candidates and self.leader:
                text = f"no answer; {self.leader} leads"
            elif answer is None:
                text = f"NO ANSWER within {self.seconds:g} s"
            else:
                text = f"{self._verdict(name):<11}{answer.ms:7.1f} ms  {answer.reply.reason}"
            yield f"  {name:<{width}}{text}".rstrip()

    def _verdict(self, name: str) -> str:
        reply = self.answers[name].reply
        if name in self.standby:
            return "stands by"
        if reply.code in UNREACHED:
            return UNDONE.get(self.request.do, "REFUSED")
        if not reply.ok:
            return "REFUSED"
        if self.request.do == "run" and reply.mode != "run":  # it starts when the leader's order arrives
            return "obeys"
        return "released" if self.request.do == "release" and not reply.code else reply.mode

    @property
    def _silent_robots(self) -> list[str]:
        """Names of robots, not candidates, that have not answered."""
        return [name for name in self.missing if name in self.recipients.each]

    @property
    def _stopped(self) -> list[str]:
        """Names of those that refuse because a stop is in force."""
        return [name for name in self.refused if self.answers[name].reply.code == "stopped"]

    @property
    def _counting(self) -> list[str]:
        """Names of those that answered and do not stand by."""
        stand_by = self.standby
        return [name for name in self.recipients.names if name in self.answers and name not in stand_by]

    def _leads(self, name: str) -> bool:
        return name in self.answers and self.answers[name].reply.leads is not False

    def _result_of(self, name: str) -> dict[str, Any]:
        reply, ms = self.answers[name]
        code = {"code": reply.code} if reply.code else {}
        return {"robot": name, "ms": round(ms, 3), "mode": reply.mode, "reason": reply.reason, **code}


def called(request: OperatorRequest) -> str:
    """A request in words, as it is typed."""
    words: list[str] = [request.do]
    for name in TAKES.get(request.do, ()):
        value = getattr(request, name)
        if name == "legs":
            words.append("of one leg" if len(value) == 1 else f"of {len(value)} legs")
        elif value is not None:
            text = value if isinstance(value, str) else f"{value:g}"
            words.append(f"{name}={text}" if request.do == "tune" else text)
    return " ".join(words)
