"""Of several orders given on pages, which may be given, and which goes on being put: rules, without a clock.

An order is put again and again until everybody has answered, for a few seconds. Meanwhile another may be
given, on this page or on one that hangs behind. The newest wins, but nobody is set going against a stop or a
hold that whoever asks for it cannot have seen. A stop is always given, at once.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from formation.once import REMEMBERED, RESTS
from formation.order import Do, OperatorRequest

TWICE = 1.0
"""The same once more within so long is the second click of one wish [s]."""
UNSEEN = 1.0
"""Who asks for something so soon after a stop or a hold has not seen it yet [s]."""
STALE = 3.0
"""A page that shows what was so long ago does not show what is [s]."""
LONG = 3600.0
"""Longer ago than anybody counts [s]: a page that has not seen anything yet shows the year 1970."""


class Overruled(ValueError):  # noqa: N818 - nothing is wrong with the order; it comes at the wrong moment
    """The order is not given; the text says why, and what to do."""


@dataclass(eq=False)
class Given:
    """An order that was given."""

    request: OperatorRequest
    at: float
    """When [s, monotonic]."""
    going: bool = True
    """Whether it is still being put."""
    over: bool = False
    """Whether it must not be put any more: something newer counts."""
    report: Future[dict[str, Any]] = field(default_factory=Future)
    """What came of it."""

    def same_as(self, request: OperatorRequest) -> bool:
        """Whether `request` asks for the same. Nobody minds a stop too many, so each stop is another."""
        one_time = {"id": "", "age": 0.0}
        mine, other = (one.model_copy(update=one_time) for one in (self.request, request))
        return request.do != "stop" and mine == other


class Precedence:
    """The orders of one operator, on however many pages."""

    def __init__(self) -> None:
        self._given: list[Given] = []  # those still going, and the newest
        self._rested = -math.inf  # when a stop or a hold was given last
        self._clicks: OrderedDict[str, Given] = OrderedDict()

    def give(
        self, request: OperatorRequest, now: float, *, click: str = "", behind: float | None = None
    ) -> tuple[Given, bool]:
        """The order as it is given, and whether that is new or what was given before. Raises Overruled.

        `click` is the page's own name of what somebody clicked, so that one that is sent twice is known;
        `behind` is how old [s] that was which the page showed.
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
            if len(self._clicks) > REMEMBERED:
                self._clicks.popitem(last=False)
        return given, True

    def close(self) -> None:
        """Nothing is put any more."""
        for one in self._given:
            one.over = True

    def _clicked_twice(self, now: float) -> Given | None:
        newest = self._given[-1] if self._given else None
        return newest if newest is not None and now - newest.at <= TWICE else None

    def _seen(self, wanted: Do, now: float, behind: float | None) -> None:
        """Refuse what may set robots going for somebody who does not see how they are."""
        if behind is not None and behind > STALE:
            ago = f"{behind:.0f} s ago" if behind < LONG else "long ago"
            raise Overruled(f"{wanted}: this page shows what was {ago}; look again first")
        for one in self._given:
            if one.going and one.request.do == "stop":
                raise Overruled(f"{wanted}: a stop is being given, and not everybody has answered it yet")
        if now - self._rested < UNSEEN + (behind or 0.0):
            raise Overruled(f"{wanted}: a stop or a hold was given just now; look, then ask again")

    def _overrule(self, given: Given) -> None:
        """The newest counts; what is older is over, except for a stop."""
        for one in self._given:
            one.over = one.over or one.request.do != "stop"
        self._given = [one for one in self._given if one.going and not one.over]
        self._given.append(given)
