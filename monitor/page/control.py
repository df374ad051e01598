"""The operator behind the page's buttons: orders as the command line gives them, on a bus of its own.

The bus is kept linked with everybody for as long as the page is served, so a stop goes out at once. Which of
several orders counts is said in `precedence`.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

from formation.mission import Mission
from formation.outcome import Outcome
from formation.transport import asking, wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.question import Reply
from formation.transport.wiring import Links
from monitor.figures.events import INFO, WARNING, Event
from monitor.page.precedence import Given, Precedence

PATIENCE = 3.0
"""How long everybody has to answer [s]."""
NO_PAPERS = "robots under certificates obey the operator alone: --control-config FILE names his configuration"
OTHERS_PAPERS = (
    "robots under certificates obey the operator alone: is the certificate in --control-config his?"
)


def on_the_bus(
    mission: Mission,
    note: Callable[[Event], None],
    *,
    connect: Sequence[str] = (),
    mode: str | None = None,
    file: Path | None = None,
    own_file: Path | None = None,
    overrides: Sequence[tuple[str, str]] = (),
) -> Operator:
    """An operator who is linked as flags say, else his file, else the mission. Raises BusError.

    `own_file` is the operator's own Zenoh configuration; without, the monitor's `file` and `overrides` serve.
    """
    implied = Links((), tuple(wiring.endpoints(mission).agents.values()))
    config = BusConfig(
        connect=tuple(connect),
        implied=None if connect else implied,
        mode=mode,
        namespace=mission.team or "",
        config_file=own_file or file,
        # nobody dials an operator, and where the monitor's file has it listen it listens itself
        overrides=(*(() if own_file else overrides), ("listen/endpoints", "[]")),
        name=OPERATOR,
    )
    why = ""
    if wiring.under_certificates(connect or implied.connect):
        why = OTHERS_PAPERS if own_file else NO_PAPERS
    try:
        return Operator(mission, Bus(config), note, why)
    except BusError as error:
        flag = "--control-config" if own_file else "--config"
        raise BusError(str(error).replace("--config", flag)) from None


class Line(Protocol):
    """What questions are put on: `formation.transport.bus.Bus`."""

    def question(self, key: str, payload: bytes, timeout: float) -> asking.Question:
        """Put one, and wait for nobody."""

    def close(self) -> None:
        """Hang up."""


class Operator:
    """Gives orders. Methods may be called from any thread."""

    def __init__(self, mission: Mission, line: Line, note: Callable[[Event], None], why: str = "") -> None:
        """Orders and what came of them are told to `note`, on the thread that gave them.

        `why` is what may be wrong if somebody does not answer.
        """
        self.token = secrets.token_urlsafe(32)
        """Who has it may give orders; another one at every start."""
        self._mission, self._line, self._note, self._why = mission, line, note, why
        self._precedence = Precedence()
        self._lock = Lock()  # held while a question is put, but never while its answers are waited for

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Have robots `do` it, and wait for their answers for `PATIENCE`; those, as `Outcome.report`.

        `click` names what somebody clicked: what is sent twice takes effect once. `seen` is the moment that
        the page showed [s, our system clock]. `what` is the order's shape, degrees and so on, as
        `formation.order.TAKES` has them. Raises ValueError, Overruled among them, for what is not ordered.
        """
        request = asking.request_for(self._mission, do, **what)
        behind = None if seen is None else max(time.time() - seen, 0.0)
        with self._lock:
            given, new = self._precedence.give(request, time.monotonic(), click=click, behind=behind)
        if new:
            self._give(given)
        return given.report.result()

    def close(self) -> None:
        """Give no more orders, and leave the bus."""
        with self._lock:
            self._precedence.close()
            self._line.close()

    def _give(self, given: Given) -> None:
        asked, put = asking.addressed(self._mission, given.request.do), partial(self._put, given)
        try:
            outcome = asking.give(put, asked, given.request, PATIENCE, over=lambda: given.over)
            self._note(_event(time.time(), given, outcome))
            given.report.set_result(self._report(outcome))
        except Exception as error:  # noqa: BLE001 - whoever waits for the report has to hear of it
            given.report.set_exception(error)
        finally:
            given.going = False

    def _put(self, given: Given, key: str, payload: bytes, timeout: float) -> asking.Question:
        """Ask, unless something newer counts: once that has been put, nothing older may be heard after it."""
        with self._lock:
            return NOT_PUT if given.over else self._line.question(key, payload, timeout)

    def _report(self, outcome: Outcome) -> dict[str, Any]:
        report = outcome.report()
        return {**report, "why": self._why} if report["missing"] and self._why else report


class NotPut:
    """A question that nobody has heard."""

    replies: Sequence[Reply] = ()
    over = True


NOT_PUT = NotPut()


def _event(at: float, given: Given, outcome: Outcome) -> Event:
    """What came of an order, for the list of events."""
    text = outcome.summary()
    for name in outcome.refused:
        text += f"; {name} refuses: {outcome.answers[name].reply.reason}"
    if given.over:
        text += "; overruled by the next order"
    return Event(at, INFO if outcome.obeyed else WARNING, "", "operator", text)
