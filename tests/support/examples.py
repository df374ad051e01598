"""How many examples hypothesis tries where the usual number finds too little."""

from __future__ import annotations

from hypothesis import settings

THOROUGH_EXAMPLES = 100
"""Of each test with `--all`: hypothesis's own number."""


def examples(thorough: int) -> settings:
    """Return settings for so many examples with `--all`, and proportionally fewer without."""
    return settings(max_examples=round(thorough * settings().max_examples / THOROUGH_EXAMPLES))
