"""What holds for all tests."""

from __future__ import annotations

import signal
from collections.abc import Iterator

import pytest
from hypothesis import settings

# The same examples every time, and no time limit for one: a busy machine is not a counter-example.
# To look for new ones: pytest --hypothesis-profile=search
settings.register_profile("seeded", derandomize=True, deadline=None)
settings.register_profile("search", max_examples=1000, deadline=None)
settings.load_profile("seeded")


@pytest.fixture
def in_a_terminal() -> Iterator[None]:
    """Signals as a terminal leaves them, though the tests themselves may have been started by nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)
