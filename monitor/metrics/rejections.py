"""Counts of rejected messages."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping

MAX_REASONS = 64
"""Number of distinct reasons that are counted, as a faulty sender could cause any number."""
_NUMBER = re.compile(r"\d[\d.e+-]*")


class Rejections:
    """Counts by key and by reason."""

    def __init__(self) -> None:
        self.by_key: Counter[str] = Counter()
        self._by_reason: Counter[str] = Counter()

    def count(self, key: str, reason: str) -> None:
        """Count one message on `key`. Reasons that differ only in numbers are one."""
        self.by_key[key] += 1
        kind = f"{key}: {_NUMBER.sub('#', reason)[:120]}"
        if kind not in self._by_reason and len(self._by_reason) >= MAX_REASONS:
            kind = "other reasons"
        self._by_reason[kind] += 1

    @property
    def by_reason(self) -> Mapping[str, int]:
        """Counts by ``key: reason``."""
        return dict(self._by_reason)
