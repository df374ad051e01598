"""The operator behind the page's buttons: orders as from the command line, on a separate bus.

The bus stays linked with all robots while the page is served, so a stop goes out at once. An order is sent
repeatedly until all robots have answered, for a few seconds. Meanwhile another may come, from this page or
from one that lags. The newest wins, but no order starts robots against a stop or a hold given here that its
page cannot have shown yet: only a stop or another hold ends the sending of a hold. A stop is always sent, at
once.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Protocol

from pydantic import ValidationError

from formation.control.plane import clip
from formation.mission.model import Mission
from formation.monitor.metrics.event import INFO, WARNING, Event
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.protocol.outcome import Outcome
from formation.protocol.request import Do, OperatorRequest
from formation.protocol.stops import MAX_REMEMBERED_REQUESTS, RESTS
from formation.stability import intent
from formation.stability.driving import first_limits
from formation.transport import asking, wiring
from formation.transport.asking import OPERATOR
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError
from formation.transport.mailbox import Reply
from formation.transport.wiring import Links

DOUBLE_CLICK_TIME = 1.0
"""The same order again within this time counts as a double click [s]."""
UNSEEN_STOP_TIME = 1.0
"""An order within this time after a stop or a hold was last sent counts as given without seeing it [s]."""
MAX_SHOWN_AGE = 3.0
"""Age of the shown moment from which on a page is too old for orders [s]."""
LONG_AGO_AGE = 3600.0
"""Age reported as "long ago" [s]: a page that has shown nothing yet reports the year 1970."""
ANSWER_TIMEOUT_SECONDS = 3.0
"""Time for all robots to answer [s]."""
NO_CERTIFICATE = (
    "robots under certificates obey the operator alone: name its configuration, --control-config FILE"
)
OTHER_CERTIFICATE = (
    "robots under certificates obey the operator alone: is that certificate in --control-config?"
)


class Overruled(ValueError):  # noqa: N818 - the order is valid, but comes at the wrong moment
    """An order is refused; the text states the cause and what to do."""


@dataclass(eq=False)
class GivenOrder:
    """An accepted order."""

    request: OperatorRequest
    at: float
    """When it was given [s, monotonic]."""
    sending: bool = True
    """Whether it is still being sent."""
    overruled: bool = False
    """Whether it must not be sent any more because a newer one counts."""
    report: Future[dict[str, Any]] = field(default_factory=Future)
    """Its result."""

    def same_as(self, request: OperatorRequest) -> bool:
        """Return whether `request` asks for the same.

        Each stop or hold is a new one: it may be given again because a robot moves, and does no harm.
        """
        one_time = {"id": "", "age": 0.0}
        mine, other = (one.model_copy(update=one_time) for one in (self.request, request))
        return request.do not in RESTS and mine == other


class Precedence:
    """The orders of one operator, from any number of pages."""

    def __init__(self) -> None:
        self._given: list[GivenOrder] = []  # orders still being sent, and the newest
        self._rested = -math.inf  # when a stop or a hold was given, or sent, last
        self._clicks: OrderedDict[str, GivenOrder] = OrderedDict()

    def accept(
        self, request: OperatorRequest, now: float, *, click: str = "", behind: float | None = None
    ) -> tuple[GivenOrder, bool]:
        """Return the accepted order, and whether it is new or an earlier one. Raises Overruled.

        `click` is the page's own id of the click, so that one sent twice is recognised; `behind` is the age
        of the moment that the page showed [s].
        """
        newest = self._given[-1] if self._given else None
        clicked_twice = newest is not None and now - newest.at <= DOUBLE_CLICK_TIME
        known = self._clicks.get(click) or (newest if clicked_twice else None)
        if known is not None and known.same_as(request):
            return known, False
        if request.do not in RESTS:
            self.check(request.do, now, behind)
        given = GivenOrder(request, now)
        self._overrule(given)
        if request.do in RESTS:
            self._rested = now
        if click:
            self._clicks[click] = given
            if len(self._clicks) > MAX_REMEMBERED_REQUESTS:
                self._clicks.popitem(last=False)
        return given, True

    def end(self, given: GivenOrder, now: float) -> None:
        """Record that an order is no longer sent, from `now` [s, monotonic] on."""
        given.sending = False
        if given.request.do in RESTS:
            self._rested = now

    def close(self) -> None:
        """End all sending."""
        for one in self._given:
            one.overruled = True

    def check(self, wanted: Do, now: float, behind: float | None = None) -> None:
        """Refuse an order that may start robots if its page does not show their present state.

        `now` [s, monotonic] and `behind` are those of `accept`. Raises Overruled.
        """
        if behind is not None and behind > MAX_SHOWN_AGE:
            ago = f"{behind:.0f} s ago" if behind < LONG_AGO_AGE else "long ago"
            raise Overruled(f"{wanted}: this page shows what was {ago}; reload it first")
        for one in self._given:
            if one.sending and (rest := one.request.do) in RESTS:
                raise Overruled(
                    f"{wanted}: a {rest} is being given, and not every robot has answered yet; wait for that"
                )
        if now - self._rested < UNSEEN_STOP_TIME + (behind or 0.0):
            raise Overruled(
                f"{wanted}: a stop or a hold was given just now; see the robots' states, then order again"
            )

    def _overrule(self, given: GivenOrder) -> None:
        """End all older orders except stops; `check` refuses those that must not end a hold."""
        for one in self._given:
            one.overruled = one.overruled or one.request.do != "stop"
        self._given = [one for one in self._given if one.sending and not one.overruled]
        self._given.append(given)


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
        why = OTHER_CERTIFICATE if own_file else NO_CERTIFICATE
    try:
        return Operator(mission, Bus(config), note, why)
    except BusError as error:
        flag = "--control-config" if own_file else "--config"
        raise BusError(str(error).replace("--config", flag)) from None


class QuestionBus(Protocol):
    """The bus for questions: `formation.transport.bus.Bus`."""

    def question(self, key: str, payload: bytes, timeout: float) -> asking.Question:
        """Send a question without waiting for answers."""

    def close(self) -> None:
        """Close the bus."""


class Operator:
    """Give orders. Methods may be called from any thread."""

    def __init__(
        self, mission: Mission, bus: QuestionBus, note: Callable[[Event], None], why: str = ""
    ) -> None:
        """`note` gets the orders and their results, on the thread that gave them.

        `why` is the likely cause if a robot does not answer.
        """
        self.token = secrets.token_urlsafe(32)
        """Token that permits giving orders; new at every start."""
        self._mission, self._bus, self._note, self._why = mission, bus, note, why
        self._precedence = Precedence()
        self._lock = Lock()  # held while a question is sent, but never while waiting for answers

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Order `do`; return the answers of `ANSWER_TIMEOUT_SECONDS` as `Outcome.report`.

        `click` identifies the click: one sent twice takes effect once. `seen` is the moment that the page
        showed [s, our system clock]. `what` holds the order's shape, degrees and so on, as in
        `formation.protocol.request.TAKES`. Raises ValueError, or its subclass Overruled, if the order is not
        given.
        """
        request = intent.request_for(self._mission, do, **what)
        behind = None if seen is None else max(time.time() - seen, 0.0)
        with self._lock:
            given, new = self._precedence.accept(request, time.monotonic(), click=click, behind=behind)
        if new:
            self._give(given)
        return given.report.result()

    def drive(self, *, driver: str, forward: float, turn: float, token: int) -> dict[str, Any]:
        """Send a driver's velocity, in shares of the greatest from -1 to 1; return the leader's answer.

        The answer has ``ok``, ``reason``, ``code``, ``mode``, and the ``token`` for the next one (the same
        if no leader gives one), see `formation.leader.driving`. `driver` is the id of the page. Raises
        ValueError, or Overruled for a velocity other than zero against a stop or a hold, as for an order.
        """
        if forward or turn:
            with self._lock:
                self._precedence.check("drive", time.monotonic())
        limits = first_limits(self._mission)
        try:
            request = OperatorRequest(
                do="drive",
                forward=clip(forward, 1.0) * limits.speed,
                turn_rate=clip(turn, 1.0) * limits.turn_rate,
                token=token,
                id=driver,
                mission=self._mission.tag,
            )
        except ValidationError:
            raise ValueError(
                "a velocity needs shares from -1 to 1, a token and the id of its driver"
            ) from None
        answer = asking.drive(self._question, self._mission, request, DRIVE_TIMEOUT_SECONDS)
        if answer is None:
            return {"ok": False, "reason": "no leader answers", "code": "", "mode": "", "token": token}
        # with token 0 the next one would count as that of a driver that begins, and need not let go
        fields = answer.model_dump(include={"ok", "reason", "code", "mode", "token"})
        return fields | {"token": answer.token or token}

    def _question(self, key: str, payload: bytes, timeout: float) -> asking.Question:
        with self._lock:
            return self._bus.question(key, payload, timeout)

    def close(self) -> None:
        """Stop giving orders, and close the bus."""
        with self._lock:
            self._precedence.close()
            self._bus.close()

    def _give(self, given: GivenOrder) -> None:
        recipients, put = asking.addressed(self._mission, given.request.do), partial(self._send, given)
        try:
            outcome = asking.give(
                put, recipients, given.request, ANSWER_TIMEOUT_SECONDS, over=lambda: given.overruled
            )
            self._note(_event(time.time(), given, outcome))
            report = outcome.report()
            given.report.set_result(
                report | {"why": self._why} if report["missing"] and self._why else report
            )
        except Exception as error:  # noqa: BLE001 - must reach the thread waiting for the report
            given.report.set_exception(error)
        finally:
            with self._lock:
                self._precedence.end(given, time.monotonic())

    def _send(self, given: GivenOrder, key: str, payload: bytes, timeout: float) -> asking.Question:
        """Send the question unless overruled: nothing older may be sent after a newer order."""
        with self._lock:
            return NOT_SENT if given.overruled else self._bus.question(key, payload, timeout)


class NotSent:
    """A question that was not sent."""

    replies: Sequence[Reply] = ()
    over = True


NOT_SENT = NotSent()


def _event(at: float, given: GivenOrder, outcome: Outcome) -> Event:
    text = outcome.summary()
    for name in outcome.refused:
        text += f"; {name} refuses: {outcome.answers[name].reply.reason}"
    if given.overruled:
        text += "; overruled by the next order"
    return Event(at, INFO if outcome.obeyed else WARNING, "", "operator", text)
