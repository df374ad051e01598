"""Which tests run, and what holds for all of them.

    pytest                  unit tests, and a thin layer of real processes (marked `smoke`): some minutes
    pytest --all            every test: slow ones, all processes, hypothesis with all its examples
    pytest tests/field      everything in a folder or a file that is named

Tests of real processes run one after another beside unit tests, as they wait most of the time. One of them
that fails while the machine stood still is run again, and the summary names it.
"""

from __future__ import annotations

import os
import re
import signal
import threading
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from time import monotonic, sleep  # as they are, though a test replaces those of `time`
from typing import TYPE_CHECKING

import pytest
from _pytest.runner import runtestprotocol
from hypothesis import settings
from xdist.remote import Producer
from xdist.scheduler.loadscope import LoadScopeScheduling
from xdist.workermanage import WorkerController

from tests.support.needs import MARKS, missing

if TYPE_CHECKING:
    from playwright.sync_api import Browser

WITH_PROCESSES = ("tests/processes/", "tests/field/")
"""Folders of tests that start processes, open sockets or wait for the wall clock."""
LAST = "tests/field/test_attacks.py"
"""Its tests measure what a robot does meanwhile: they run when most unit tests beside them have ended."""
WAITING_WORKERS = 1
"""With --all, workers besides one for each core: for tests with processes, one after another. Two of them at
a time failed tests of attacks, which measure what a robot does meanwhile."""
UNIT_NICENESS = 19
"""How much the other workers then give way: slowness fails no unit test."""
MAX_RUNS_IN_STALLS = 3
"""How often a test with processes is run that fails each time while the machine stands still."""
STALLED = "stalled"
"""Name of the property of a test's report that says how long the machine stood still."""
COMPILING = re.compile(
    r"^from formation\.(simulation\.simulate|stability\.analysis|deploy\.cli) import", re.MULTILINE
)
"""Imports of the files that simulate. One worker runs all of them: compiling a law takes it ten seconds."""
ROOT = Path(__file__).parents[1]
QUICK_EXAMPLES = 20
"""Examples of each hypothesis test without `--all`; hypothesis itself takes 100."""

MIN_STALL_SECONDS = 0.1
"""A thread that asks for a short sleep is late by this much only if the machine had no time for it."""
SLEEP_SECONDS = 0.01

# The same examples every time, and no time limit for one: a busy machine is not a counter-example.
# To look for new ones: pytest --hypothesis-profile=search
settings.register_profile("quick", derandomize=True, deadline=None, max_examples=QUICK_EXAMPLES)
settings.register_profile("thorough", derandomize=True, deadline=None)
settings.register_profile("search", max_examples=1000, deadline=None)


class StallWatch:
    """Record the longest delay of a thread that has nothing to do but to wake."""

    def __init__(self) -> None:
        self._longest = 0.0
        self._slept = monotonic()  # since when the thread sleeps, or since the last call if that was later
        self._changing = threading.Lock()
        self._thread = threading.Thread(target=self._watch, name="stalls", daemon=True)

    def start(self) -> None:
        """Watch until the process ends."""
        self._thread.start()

    def longest_since_last_call(self) -> float:
        """Return the longest delay since the last call [s], the present one included, and forget it."""
        with self._changing:
            now = monotonic()
            longest = max(self._longest, now - self._slept - SLEEP_SECONDS)
            self._longest, self._slept = 0.0, now
        return longest

    def _watch(self) -> None:
        while True:
            sleep(SLEEP_SECONDS)
            with self._changing:
                now = monotonic()
                self._longest = max(self._longest, now - self._slept - SLEEP_SECONDS)
                self._slept = now


class ByCost(LoadScopeScheduling):  # type: ignore[misc] # xdist says nothing of its types
    """Hand out unit tests file by file, to one worker those that compile, and to one those with processes.

    Those with processes wait most of the time, so the last worker begins with them.
    """

    def _assign_work_unit(self, node: WorkerController) -> None:
        if "processes" in self.workqueue:
            is_last = node.gateway.id == f"gw{self.numnodes - 1}"
            self.workqueue.move_to_end("processes", last=not is_last)
        super()._assign_work_unit(node)

    def _split_scope(self, nodeid: str) -> str:
        if _has_processes(nodeid):
            return "processes"
        path = nodeid.partition("::")[0]
        return "simulations" if _compiles(path) else path


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --all."""
    parser.addoption(
        "--all", action="store_true", help="run every test, slow ones and all real processes too"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Choose how many examples hypothesis tries, unless the command line did, and which workers go first."""
    workers = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    if workers > _cores() and os.environ["PYTEST_XDIST_WORKER"] != f"gw{workers - 1}":
        os.nice(UNIT_NICENESS)
    if not config.getoption("--hypothesis-profile"):
        settings.load_profile("thorough" if config.getoption("--all") else "quick")


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """Return the number of worker processes: none where files are named, for output and debuggers."""
    if any(argument.partition("::")[0].endswith(".py") for argument in config.args):
        return 0
    only_units = all(Path(argument).is_relative_to("tests/unit") for argument in config.args)
    return _cores() + (WAITING_WORKERS if config.getoption("--all") and not only_units else 0)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> LoadScopeScheduling:
    """Return what hands out the tests to worker processes."""
    return ByCost(config, log)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files with processes of which no test would be selected: importing them takes seconds."""
    if not _selects_by_cost(config) or not collection_path.name.startswith("test_"):
        return None
    if not _has_processes(collection_path.relative_to(config.rootpath).as_posix()):
        return None
    return True if "pytest.mark.smoke" not in collection_path.read_text(encoding="utf-8") else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Select by cost, put tests of attacks last, and skip by name what needs what this machine lacks."""
    if _selects_by_cost(config):
        _deselect_costly(config, items)
    items.sort(key=lambda item: item.nodeid.startswith(LAST))
    if os.environ.get("FORMATION_TEST_ALL") == "1":
        return
    for item in items:
        lacking = _lacking(item)
        if lacking:
            item.add_marker(pytest.mark.skip(reason=f"{item.name} needs {lacking}"))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Fail a test that cannot run where FORMATION_TEST_ALL=1 says that every test has to."""
    if os.environ.get("FORMATION_TEST_ALL") == "1" and (lacking := _lacking(item)):
        pytest.fail(f"{item.name} needs {lacking}, and FORMATION_TEST_ALL=1 leaves out none", pytrace=False)


def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Run a test with processes; again if its call failed and the machine stood still meanwhile."""
    if not _has_processes(item.nodeid):
        return None
    watch = _stall_watch()
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    for run in range(1, MAX_RUNS_IN_STALLS + 1):
        watch.longest_since_last_call()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        stall = watch.longest_since_last_call()
        if run == MAX_RUNS_IN_STALLS or stall < MIN_STALL_SECONDS or not _failed_in_call(reports):
            break
        item.user_properties.append((STALLED, f"failed while the machine stood still for {stall:.2f} s"))
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name every test that was run again, and why."""
    for outcome in ("passed", "failed"):
        for report in terminalreporter.getreports(outcome):
            for name, text in report.user_properties:
                if name == STALLED and report.when == "call":
                    terminalreporter.line(f"RUN AGAIN {report.nodeid}: {text}; then it {outcome}")


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _compiles(path: str) -> bool:
    return bool(COMPILING.search((ROOT / path).read_text(encoding="utf-8")))


@cache
def _stall_watch() -> StallWatch:
    watch = StallWatch()
    watch.start()
    return watch


def _failed_in_call(reports: Sequence[pytest.TestReport]) -> bool:
    return any(report.failed and report.when == "call" for report in reports)


@pytest.fixture
def in_a_terminal() -> Iterator[None]:
    """Handle signals as a terminal leaves them, though the tests may run under nohup or in the background."""
    hangup = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    interrupt = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, interrupt)
    signal.signal(signal.SIGHUP, hangup)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Start a browser for all tests of a module; meanwhile no other event loop can run."""
    from tests.support.served import browsing

    with browsing() as one:
        yield one


def _selects_by_cost(config: pytest.Config) -> bool:
    return not config.getoption("--all") and config.args_source is pytest.Config.ArgsSource.TESTPATHS


def _has_processes(nodeid: str) -> bool:
    return nodeid.startswith(WITH_PROCESSES)


def _deselect_costly(config: pytest.Config, items: list[pytest.Item]) -> None:
    costly = [item for item in items if _costly(item)]
    chosen = [item for item in items if not _costly(item)]
    config.hook.pytest_deselected(items=costly)
    items[:] = chosen


def _costly(item: pytest.Item) -> bool:
    if item.get_closest_marker("slow") is not None:
        return True
    return _has_processes(item.nodeid) and item.get_closest_marker("smoke") is None


def _lacking(item: pytest.Item) -> str:
    marks = (mark for mark in MARKS if item.get_closest_marker(mark) is not None)
    return next(filter(None, map(missing, marks)), "")
