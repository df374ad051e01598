"""Rules for several orders from pages: which is accepted, and which goes on being sent. No clock.

An order is sent repeatedly until all robots have answered, for a few seconds. Meanwhile another may come,
from this page or from one that lags. The newest wins, but no order starts robots against a stop or a hold
that its page cannot have shown yet. A stop is always sent, at once.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from formation.protocol.order import Do, OperatorRequest
from formation.protocol.stops import MAX_REMEMBERED_REQUESTS, RESTS

DOUBLE_CLICK_TIME = 1.0
"""The same order again within this time counts as a double click [s]."""
UNSEEN_STOP_TIME = 1.0
"""An order within this time after a stop or a hold counts as given without seeing it [s]."""
MAX_SHOWN_AGE = 3.0
"""Age of the shown moment from which on a page is too old for orders [s]."""
LONG_AGO_AGE = 3600.0
"""Age reported as "long ago" [s]: a page that has shown nothing yet reports the year 1970."""


class Overruled(ValueError):  # noqa: N818 - the order is valid, but comes at the wrong moment
    """An order is refused; the text states the cause and what to do."""


@dataclass(eq=False)
class Given:
    """An accepted order."""

    request: OperatorRequest
    at: float
    """When it was given [s, monotonic]."""
    going: bool = True
    """Whether it is still being sent."""
    over: bool = False
    """Whether it must not be sent any more because a newer one counts."""
    report: Future[dict[str, Any]] = field(default_factory=Future)
    """Its result."""

    def same_as(self, request: OperatorRequest) -> bool:
        """Return whether `request` asks for the same. Each stop is a new one, as repeats do no harm."""
        one_time = {"id": "", "age": 0.0}
        mine, other = (one.model_copy(update=one_time) for one in (self.request, request))
        return request.do != "stop" and mine == other


class Precedence:
    """The orders of one operator, from any number of pages."""

    def __init__(self) -> None:
        self._given: list[Given] = []  # orders still being sent, and the newest
        self._rested = -math.inf  # when a stop or a hold was given last
        self._clicks: OrderedDict[str, Given] = OrderedDict()

    def give(
        self, request: OperatorRequest, now: float, *, click: str = "", behind: float | None = None
    ) -> tuple[Given, bool]:
        """Return the accepted order, and whether it is new or an earlier one. Raises Overruled.

        `click` is the page's own id of the click, so that one sent twice is recognised; `behind` is the age
        of the moment that the page showed [s].
        """
        known = self._clicks.get(click) or self._clicked_twice(now)
        if known is not None and known.same_as(request):
            return known, False
        if request.do not in RESTS:
            self._seen(request.do, now, behind)
        given = Given(request, now)
        self._overrule(given)
        if request.do in RESTS:
            self._rested = now
        if click:
            self._clicks[click] = given
            if len(self._clicks) > MAX_REMEMBERED_REQUESTS:
                self._clicks.popitem(last=False)
        return given, True

    def close(self) -> None:
        """End all sending."""
        for one in self._given:
            one.over = True

    def _clicked_twice(self, now: float) -> Given | None:
        newest = self._given[-1] if self._given else None
        return newest if newest is not None and now - newest.at <= DOUBLE_CLICK_TIME else None

    def _seen(self, wanted: Do, now: float, behind: float | None) -> None:
        """Refuse an order that may start robots if its page does not show their present state."""
        if behind is not None and behind > MAX_SHOWN_AGE:
            ago = f"{behind:.0f} s ago" if behind < LONG_AGO_AGE else "long ago"
            raise Overruled(f"{wanted}: this page shows what was {ago}; look again first")
        for one in self._given:
            if one.going and one.request.do == "stop":
                raise Overruled(f"{wanted}: a stop is being given, and not every robot has answered it yet")
        if now - self._rested < UNSEEN_STOP_TIME + (behind or 0.0):
            raise Overruled(f"{wanted}: a stop or a hold was given just now; look, then ask again")

    def _overrule(self, given: Given) -> None:
        """End all older orders except stops."""
        for one in self._given:
            one.over = one.over or one.request.do != "stop"
        self._given = [one for one in self._given if one.going and not one.over]
        self._given.append(given)
