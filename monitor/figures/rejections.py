"""Messages that were not what they should be, counted."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

MOST = 64
"""Kinds of reasons that are told apart: whoever sends rubbish decides what the reasons say, not how many."""
_NUMBER = re.compile(r"\d[\d.e+-]*")


class Rejections:
    """Counts by key and by reason."""

    def __init__(self) -> None:
        self.by_key: Counter[str] = Counter()
        self._by_reason: Counter[str] = Counter()

    def count(self, key: str, reason: str) -> None:
        """Count one message on `key`. Numbers in `reason` do not make it another one."""
        self.by_key[key] += 1
        kind = f"{key}: {_NUMBER.sub('#', reason)[:120]}"
        if kind not in self._by_reason and len(self._by_reason) >= MOST:
            kind = "other reasons"
        self._by_reason[kind] += 1

    @property
    def by_reason(self) -> Mapping[str, int]:
        """Counts by ``key: reason``."""
        return dict(self._by_reason)
