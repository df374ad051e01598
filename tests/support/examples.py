"""Which cases of a test run by default, and how many examples hypothesis tries."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import settings

THOROUGH_EXAMPLES = 100
"""Of each test with `--all`: hypothesis's own number."""


def examples(thorough: int) -> settings:
    """Return settings for so many examples with `--all`, and proportionally fewer without."""
    return settings(max_examples=round(thorough * settings().max_examples / THOROUGH_EXAMPLES))


def slow(*cases: Any) -> Iterable[Any]:
    """Mark cases of a parametrised test as slow; a tuple is a case of several arguments."""
    marks = pytest.mark.slow
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=marks) for case in cases]
