"""What came of an operator's order: who was asked, who obeys, who does not; for people and for programs.

Of those who may lead, one does, and what that one says counts; the others stand by. So a leader that has died
is missed only as long as nobody else leads.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from formation.order import UNREACHED, OperatorReply, OperatorRequest

UNDONE = {"stop": "NOT STOPPED", "hold": "NOT HELD"}
"""What a robot is that an order does not reach."""


class Answer(NamedTuple):
    """One robot's answer."""

    reply: OperatorReply
    ms: float
    """Since the first question was put, to whomever [ms]."""


class Asked(NamedTuple):
    """Who is asked."""

    candidates: tuple[str, ...]
    """Who may lead, by rank: whoever does has to answer."""
    each: tuple[str, ...] = ()
    """Who has to answer besides, one and all."""

    @property
    def names(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.candidates, *self.each)


class Outcome(NamedTuple):
    """The answers to one order, as far as they have come."""

    request: OperatorRequest
    asked: Asked
    answers: dict[str, Answer]
    at: float
    """When the first question was put [s, our system clock]."""
    seconds: float
    """How long answers are waited for [s]."""

    @property
    def leader(self) -> str | None:
        """Who leads, by his own word."""
        leading = (name for name in self.asked.candidates if self._leads(name))
        return next(leading, None)

    @property
    def missing(self) -> list[str]:
        """Who has not answered; the leader as the mission names it if nobody says that he leads."""
        lost = [] if self.leader else [self.asked.candidates[0]]
        return lost + [name for name in self.asked.each if name not in self.answers]

    @property
    def standing_by(self) -> list[str]:
        """Who may lead and says that he does not."""
        return [name for name in self.asked.candidates if name in self.answers and not self._leads(name)]

    @property
    def refused(self) -> list[str]:
        """Who answered and does not obey."""
        return [name for name in self._counting if not self.answers[name].reply.ok]

    @property
    def unreached(self) -> list[str]:
        """Robots whose agent has latched a stop or a hold that cannot reach the robot itself."""
        return [name for name in self.refused if self.answers[name].reply.code in UNREACHED]

    @property
    def nothing(self) -> list[str]:
        """Those that had nothing to release."""
        return [name for name in self._counting if self.answers[name].reply.code == "nothing"]

    @property
    def obeyed(self) -> bool:
        """Whether everybody has who counts."""
        return not self.missing and not self.refused

    @property
    def unsettled(self) -> list[str]:
        """Who is still to be asked: who is silent, and who stands by while nobody leads."""
        silent = [name for name in self.asked.names if name not in self.answers]
        return silent if self.leader else silent + self.standing_by

    @property
    def whole(self) -> bool:
        """Whether there is nobody left to ask."""
        return not self.unsettled

    def report(self) -> dict[str, Any]:
        """For a program."""
        return {
            **{name: value for name, value in self.request.spelled.items() if name != "age"},
            "at": round(self.at, 6),
            "leader": self.leader,
            "acknowledged": [self._told(name) for name in self._counting if self.answers[name].reply.ok],
            "refused": [self._told(name) for name in self.refused],
            "missing": self.missing,
            "standing_by": self.standing_by,
            **({"unreached": self.unreached} if self.request.do in UNDONE else {}),
            "advice": list(self._advice()),
        }

    def words(self) -> str:
        """For people: a robot a line, and what they come to."""
        return "\n".join([*self._lines(), self.summary()])

    def summary(self) -> str:
        """What the answers come to, in a line."""
        counting = self._counting
        agree = len(counting) - len(self.refused)
        line = f"{called(self.request)}: {agree} of {len(self.asked.each) + 1} obey"
        if counting:
            line += f", slowest {max(self.answers[name].ms for name in counting):.0f} ms"
        if self.missing:
            line += f"; no answer from {', '.join(self.missing)}"
        if not self.leader and self.standing_by:
            line += f", standing by: {', '.join(self.standing_by)}"
        return "; ".join([line, *self._advice()])

    def _advice(self) -> Iterator[str]:
        """What the operator should know or do, a clause each."""
        do, robots = self.request.do, [name for name in self.missing if name in self.asked.each]
        if do == "stop" and not self.leader and self._counting:
            yield "robots that obey stand, with a leader or without"
        if do in UNDONE and self.unreached:
            yield f"{UNDONE[do]}: {', '.join(self.unreached)}: use the robot's own switch"
        if do in UNDONE and robots:
            yield f"{', '.join(robots)} may still drive: use the robot's own switch"
        if do == "run" and robots:
            yield f"{', '.join(robots)} may still be held: order run again"
        if do == "release":
            if self.nothing:
                yield f"nothing to release at {', '.join(self.nothing)}"
            if len(self.nothing) < len(self._counting) - len(self.refused):
                yield "everybody holds until you order run"
            if robots:
                yield f"{', '.join(robots)} may still be stopped: release again"

    def _lines(self) -> Iterator[str]:
        width = max(12, 2 + max(len(name) for name in self.asked.names))
        for name in self.asked.names:
            answer = self.answers.get(name)
            if answer is None and name in self.asked.candidates and self.leader:
                text = f"no answer; {self.leader} leads"
            elif answer is None:
                text = f"NO ANSWER within {self.seconds:g} s"
            else:
                text = f"{self._verdict(name):<11}{answer.ms:7.1f} ms  {answer.reply.reason}"
            yield f"  {name:<{width}}{text}".rstrip()

    def _verdict(self, name: str) -> str:
        reply = self.answers[name].reply
        if name in self.standing_by:
            return "stands by"
        if reply.code in UNREACHED:
            return UNDONE.get(self.request.do, "REFUSED")
        if not reply.ok:
            return "REFUSED"
        return "released" if self.request.do == "release" and not reply.code else reply.mode

    @property
    def _counting(self) -> list[str]:
        """Whose answers there are, those who stand by left out."""
        stand_by = self.standing_by
        return [name for name in self.asked.names if name in self.answers and name not in stand_by]

    def _leads(self, name: str) -> bool:
        return name in self.answers and self.answers[name].reply.leads is not False

    def _told(self, name: str) -> dict[str, Any]:
        reply, ms = self.answers[name]
        code = {"code": reply.code} if reply.code else {}
        return {"robot": name, "ms": round(ms, 3), "mode": reply.mode, "reason": reply.reason, **code}


def called(request: OperatorRequest) -> str:
    """An order in words, as it is typed."""
    what: tuple[Any, ...] = ()
    match request.do:
        case "shape":
            what = (request.shape,)
        case "rotate":
            what = (f"{request.degrees:g}",)
        case "scale":
            what = (f"{request.factor:g}",)
        case "speed":
            what = (f"{request.speed:g}", f"{request.degrees:g}")
        case "route":
            legs = len(request.legs or ())
            what = ("of one leg" if legs == 1 else f"of {legs} legs",)
        case "tune":
            asked = {"k_p": request.k_p, "k_i": request.k_i}
            what = tuple(f"{name}={value:g}" for name, value in asked.items() if value is not None)
    return " ".join([request.do, *map(str, what)])
