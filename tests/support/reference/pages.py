"""The pages of docs/reference that are generated, and what generates them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from tests.support.reference import commands, mission_keys, states

PAGES: Mapping[str, Callable[[], str]] = MappingProxyType(
    {"mission-keys.md": mission_keys.page, "commands.md": commands.page, "states.md": states.page}
)
REGENERATE = "python3 deploy/env.py python -m tests.support.reference"
"""Writes them all, in a clone of the repository."""
