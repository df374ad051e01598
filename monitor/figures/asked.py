"""What operators ask of those who may lead, by whatever means: they repeat it in their statuses."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from typing import Any, NamedTuple

from formation.order import OperatorRequest, decode
from formation.outcome import called
from formation.wire import BadMessage

ASKED = "asked"
"""Where a status says what was asked: a JSON list of requests, with ``ok`` and the ``reason``."""
REMEMBERED = 256
"""Requests that are known when they are said again."""
LONGEST = 200
"""[letters]"""


class Asked(NamedTuple):
    """One request, and how it was answered."""

    number: int
    """Which one, from 1."""
    name: str
    """Whom."""
    what: str
    """As it is typed."""
    ok: bool
    reason: str


class Requests:
    """Everything that was asked, each once."""

    def __init__(self) -> None:
        self.newest: deque[Asked] = deque(maxlen=64)
        self._known: dict[tuple[str, str, str], None] = {}  # who was asked to do what, by its id
        self._count = 0

    def take(self, name: str, values: Mapping[str, str]) -> None:
        """Learn from what `name` says in its status; what is no list of requests tells nothing."""
        if ASKED not in values:
            return
        try:
            said = json.loads(values[ASKED])
        except (ValueError, RecursionError):
            return
        for one in said if isinstance(said, list) else ():
            if isinstance(one, dict):
                self._take(name, one)

    def _take(self, name: str, said: dict[str, Any]) -> None:
        ok, reason = said.pop("ok", None) is True, said.pop("reason", "")
        try:
            request = decode(OperatorRequest, json.dumps(said).encode())
        except (BadMessage, RecursionError):
            return
        known = name, request.do, request.id
        if not request.id or known in self._known:
            return
        self._known[known] = None
        if len(self._known) > REMEMBERED:
            self._known.pop(next(iter(self._known)))
        self._count += 1
        why = reason[:LONGEST] if isinstance(reason, str) else ""
        self.newest.append(Asked(self._count, name, called(request), ok, why))
