"""What holds for all tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest
from hypothesis import settings

from tests.needs import MARKS, missing

if TYPE_CHECKING:
    from playwright.sync_api import Browser

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


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A browser for all tests of a module; not of a session, for meanwhile no other event loop can run."""
    from tests.monitor.page.served import browsing

    with browsing() as one:
        yield one


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Leave out, by name, tests that need what this machine lacks; with FORMATION_TEST_ALL=1 none is."""
    if os.environ.get("FORMATION_TEST_ALL") == "1":
        return
    for item in items:
        lacking = _lacking(item)
        if lacking:
            item.add_marker(pytest.mark.skip(reason=f"{item.name} needs {lacking}"))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Where every test has to run, one that cannot has failed."""
    if os.environ.get("FORMATION_TEST_ALL") == "1" and (lacking := _lacking(item)):
        pytest.fail(f"{item.name} needs {lacking}, and FORMATION_TEST_ALL=1 leaves out none", pytrace=False)


def _lacking(item: pytest.Item) -> str:
    marks = (mark for mark in MARKS if item.get_closest_marker(mark) is not None)
    return next(filter(None, map(missing, marks)), "")
