"""The stop and the hold in force at one robot or candidate, and the requests that end them.

Each stop and each hold has an id. ``release`` ends the stop that it names, and leaves a new hold behind:
ending a stop never starts motion. ``run`` ends the hold that it names, and is refused while stopped. So a
request that was sent before the newest stop or hold ends neither, however late or often it arrives.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from formation.protocol.order import Code, Mode, OperatorRequest

MOTION = frozenset({"stop", "hold", "release", "run"})
"""Requests that change what is in force. Each robot and each candidate accepts them."""


class Result(NamedTuple):
    """Result of a request."""

    ok: bool
    reason: str = ""
    code: Code = ""


@dataclass(slots=True)
class Rest:
    """The newest stop and the newest hold, each by its id; empty for none."""

    stop: str = ""
    hold: str = ""

    @property
    def mode(self) -> Mode | None:
        """What is in force, a stop before a hold; None for neither."""
        return "stop" if self.stop else "hold" if self.hold else None

    def change(self, request: OperatorRequest, fact: str) -> Result:
        """Obey one of `MOTION`. `fact` is the id of the stop or the hold that it leaves in force."""
        match request.do:
            case "stop":
                self.stop = fact
            case "hold":
                self.hold = fact
            case "release":
                return self._release(request, fact)
            case "run":
                return self._run(request)
            case _:
                raise ValueError(f"{request.do}: must be one of {', '.join(sorted(MOTION))}")
        return Result(ok=True)

    def _release(self, request: OperatorRequest, fact: str) -> Result:
        if not self.stop:
            return Result(ok=True, code="nothing", reason="nothing to release: no stop is in force")
        if not request.ends:
            return Result(
                ok=False, code="unnamed", reason="release must name the stop that it ends: query first"
            )
        if self.stop not in request.ends:
            return Result(ok=False, code="another", reason="nothing to release: another stop is in force")
        self.stop, self.hold = "", fact
        return Result(ok=True)

    def _run(self, request: OperatorRequest) -> Result:
        if self.stop:
            return Result(ok=False, code="stopped", reason="stopped: release it first")
        if self.hold and not request.ends:
            return Result(ok=False, code="unnamed", reason="run must name the hold that it ends: query first")
        if self.hold and self.hold not in request.ends:
            return Result(ok=False, code="another", reason="held since: order run again")
        self.hold = ""
        return Result(ok=True)
