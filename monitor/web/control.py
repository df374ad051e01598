"""The operator behind the page's buttons: orders as from the command line, on a separate bus.

The bus stays linked with all robots while the page is served, so a stop goes out at once. `precedence`
decides which of several orders counts.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

from formation.mission.model import Mission
from formation.monitor.metrics.events import INFO, WARNING, Event
from formation.monitor.web.precedence import Given, Precedence
from formation.protocol.outcome import Outcome
from formation.transport import asking, wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.mailbox import Reply
from formation.transport.wiring import Links

ANSWER_TIMEOUT_SECONDS = 3.0
"""Time for all robots to answer [s]."""
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
    """Return an operator, linked by flags, else its file, else the mission. Raises BusError.

    `own_file` is the operator's own Zenoh configuration; the default is the monitor's `file` and `overrides`.
    """
    implied = Links((), tuple(wiring.endpoints(mission).agents.values()))
    config = BusConfig(
        connect=tuple(connect),
        implied=None if connect else implied,
        mode=mode,
        namespace=mission.team or "",
        config_file=own_file or file,
        # an operator needs no listener, and the address in the monitor's file is in use
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
    """The bus for questions: `formation.transport.bus.Bus`."""

    def question(self, key: str, payload: bytes, timeout: float) -> asking.Question:
        """Send a question without waiting for answers."""

    def close(self) -> None:
        """Close the bus."""


class Operator:
    """Give orders. Methods may be called from any thread."""

    def __init__(self, mission: Mission, line: Line, note: Callable[[Event], None], why: str = "") -> None:
        """`note` gets the orders and their results, on the thread that gave them.

        `why` is the likely cause if a robot does not answer.
        """
        self.token = secrets.token_urlsafe(32)
        """Token that permits giving orders; new at every start."""
        self._mission, self._line, self._note, self._why = mission, line, note, why
        self._precedence = Precedence()
        self._lock = Lock()  # held while a question is sent, but never while waiting for answers

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Order `do`; return the answers of `ANSWER_TIMEOUT_SECONDS` as `Outcome.report`.

        `click` identifies the click: one sent twice takes effect once. `seen` is the moment that the page
        showed [s, our system clock]. `what` holds the order's shape, degrees and so on, as in
        `formation.protocol.order.TAKES`. Raises ValueError, or its subclass Overruled, if the order is not
        given.
        """
        request = asking.request_for(self._mission, do, **what)
        behind = None if seen is None else max(time.time() - seen, 0.0)
        with self._lock:
            given, new = self._precedence.give(request, time.monotonic(), click=click, behind=behind)
        if new:
            self._give(given)
        return given.report.result()

    def close(self) -> None:
        """Stop giving orders, and close the bus."""
        with self._lock:
            self._precedence.close()
            self._line.close()

    def _give(self, given: Given) -> None:
        recipients, put = asking.addressed(self._mission, given.request.do), partial(self._put, given)
        try:
            outcome = asking.give(
                put, recipients, given.request, ANSWER_TIMEOUT_SECONDS, over=lambda: given.over
            )
            self._note(_event(time.time(), given, outcome))
            given.report.set_result(self._report(outcome))
        except Exception as error:  # noqa: BLE001 - must reach the thread waiting for the report
            given.report.set_exception(error)
        finally:
            given.going = False

    def _put(self, given: Given, key: str, payload: bytes, timeout: float) -> asking.Question:
        """Send the question unless overruled: nothing older may be sent after a newer order."""
        with self._lock:
            return NOT_PUT if given.over else self._line.question(key, payload, timeout)

    def _report(self, outcome: Outcome) -> dict[str, Any]:
        report = outcome.report()
        return {**report, "why": self._why} if report["missing"] and self._why else report


class NotPut:
    """A question that was not sent."""

    replies: Sequence[Reply] = ()
    over = True


NOT_PUT = NotPut()


def _event(at: float, given: Given, outcome: Outcome) -> Event:
    """Return an order's result for the list of events."""
    text = outcome.summary()
    for name in outcome.refused:
        text += f"; {name} refuses: {outcome.answers[name].reply.reason}"
    if given.over:
        text += "; overruled by the next order"
    return Event(at, INFO if outcome.obeyed else WARNING, "", "operator", text)
