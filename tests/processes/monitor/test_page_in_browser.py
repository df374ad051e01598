"""The live page of a real run of six robots, in a real browser."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import psutil
import pytest
from playwright.sync_api import Browser, Page

from formation.mission.file import load
from tests.support.child import PATIENCE
from tests.support.launched import started, wait_until_running
from tests.support.served import until, watched

pytestmark = [pytest.mark.processes, pytest.mark.browser, pytest.mark.timeout(240)]
SIX = load("six_robots")
PAGE = ("--page", "127.0.0.1:0", "--record", "run.mcap")
LOST_WITHIN = 2.0
"""Longest time until a killed robot is shown as lost [s], apart from delays of the page and its frames."""
POST = """(token) => fetch('api/order', {
  method: 'POST',
  headers: {'Content-Type': 'application/json', ...(token && {Authorization: `Bearer ${token}`})},
  body: JSON.stringify({do: 'stop'}),
}).then((answer) => answer.status)"""
STATES = "formation.model.robots.map((robot) => robot.word)"
RUNNING = f"{STATES}.every((word) => word === 'run') && {STATES}"
"""The states once all robots run; a robot may hold for a moment after a stall of the machine."""
PLACES = "formation.model.robots.map((robot) => [robot.place.x, robot.place.y])"


def page_of(process: subprocess.Popen[str]) -> str:
    """Return the address of the page, as the run prints it."""
    assert process.stderr is not None
    return next(line for line in process.stderr if line.startswith("Page: ")).split()[1]


def agent_of(robot: str, children: list[psutil.Process]) -> psutil.Process:
    return next(child for child in children if {"formation.agent", robot} <= set(child.cmdline()))


def test_browser_shows_run_lost_robot_and_stop(browser: Browser, tmp_path: Path) -> None:
    with started("six_robots", "--control", "--duration", "120", *PAGE, folder=tmp_path) as process:
        invitation = page_of(process)
        children = wait_until_running(process, 0.5)
        with watched(browser, invitation, viewport={"width": 1280, "height": 800}) as page:
            assert "token" not in page.url
            _check_robots_move_and_error_falls(page)
            _check_stop_needs_token(browser, invitation.partition("#")[0])
            assert until(page, RUNNING) == ["run"] * len(SIX.names)  # a robot in stop would stay there
            _check_robot_of_killed_agent_is_lost(page, agent_of("robot5", children))
            _check_other_robots_stop(page)


def _check_robots_move_and_error_falls(page: Page) -> None:
    known = "formation.model.frame?.error > 0 && formation.model.robots.every((one) => one.place)"
    places, error = until(page, f"{known} && [{PLACES}, formation.model.frame.error]")
    low = f"formation.model.frame.error < {min(0.5 * error, SIX.settled)}"
    until(page, f"formation.model.frame.error !== null && {low}")
    assert all(before != after for before, after in zip(places, page.evaluate(PLACES), strict=True))
    assert page.locator("#robot-rows tr").count() == len(SIX.names)
    page.locator("#settled", has_text="at ").wait_for()
    page.locator("#event-list li", has_text="settled").first.wait_for()
    assert page.inner_text("#recording").startswith("●")
    page.locator("#connection", has_text="live").wait_for()


def _check_stop_needs_token(browser: Browser, address: str) -> None:
    with watched(browser, address, tolerated="status of 401") as stranger:
        assert not stranger.is_visible('[data-do="stop"]')
        assert [stranger.evaluate(POST, token) for token in ("", "guessed")] == [401, 401]


def _check_robot_of_killed_agent_is_lost(page: Page, agent: psutil.Process) -> None:
    row = page.locator('[data-robot="robot5"] td.state')
    page.evaluate("""() => {
      const cell = document.querySelector('[data-robot="robot5"] td.state');
      new MutationObserver((_, observer) => {
        if (!cell.textContent.includes('lost')) return;
        globalThis.lostAt = Date.now() / 1000;
        observer.disconnect();
      }).observe(cell, {subtree: true, childList: true, characterData: true});
      let last = performance.now();
      globalThis.heldUp = 0;
      setInterval(() => {
        const now = performance.now();
        const late = Math.max((now - last) / 1000 - 0.1, formation.stream.age - 0.2);
        globalThis.heldUp = Math.max(globalThis.heldUp, late);
        last = now;
      }, 100);
    }""")
    killed = time.time()
    agent.kill()
    row.filter(has_text="lost").wait_for()
    assert page.evaluate("lostAt") - killed < LOST_WITHIN + page.evaluate("heldUp")
    page.locator("#event-list li", has_text="lost").first.wait_for()


def _check_other_robots_stop(page: Page) -> None:
    page.click('[data-do="stop"]')
    result = page.locator("#acknowledgements li")
    result.nth(len(SIX.names)).wait_for()
    advice, missing, *obeyed = result.all_inner_texts()
    assert advice == "robot5 may still drive: use the robot's own switch"
    assert missing == "✕ robot5 NO ANSWER"
    assert all(text.startswith("✓ ") and text.endswith(" ms") for text in obeyed)
    assert {text.split()[1] for text in (missing, *obeyed)} == set(SIX.names)
    until(page, f"{STATES}.filter((word) => word === 'stop').length === {len(SIX.names) - 1}")
    page.locator("#event-list li", has_text="operator").first.wait_for()
    deadline = time.monotonic() + PATIENCE
    while not _all_stand(page):
        assert time.monotonic() < deadline, "robots still move"


def _all_stand(page: Page) -> bool:
    """Whether no follower moves for a second."""
    before = page.evaluate(PLACES)
    until(page, f"formation.model.frame.t > {page.evaluate('formation.model.frame.t') + 1.0}")
    after = page.evaluate(PLACES)
    followers = range(1, len(SIX.names))
    return all(abs(after[n][k] - before[n][k]) < 0.005 for n in followers for k in (0, 1))
