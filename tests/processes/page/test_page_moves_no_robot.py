"""Mistakes of operators and browsers at a page set no standing robot in motion."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page

from formation.monitor.web import control
from formation.monitor.web.control import Operator
from tests.processes.page.scene import Scene
from tests.processes.page.test_control import SIX, Team
from tests.support.child import free_endpoint
from tests.support.served import PATIENT, Served, served, until, watched

pytestmark = pytest.mark.browser
REFUSED = "status of 40"
"""Text in the browser's console about a refused order."""


class Now(Scene):
    """A scene on the system clock."""

    @property
    def now(self) -> float:
        """System clock [s]."""
        return time.time()

    def step(self) -> dict[str, object]:
        return {**super().step(), "t": self.now}


@pytest.fixture
def team() -> Team:
    """A team that was ordered to hold and then to stop."""
    team = Team()
    team.leader.request(b'{"do":"hold"}', 0.0)
    for name in SIX.names:
        team._ask(name, b'{"do":"stop"}')
    return team


@pytest.fixture
def operator(team: Team) -> Operator:
    return Operator(SIX, team, lambda _: None)


@pytest.fixture
def desk(operator: Operator) -> Iterator[Served]:
    with served(Now(6, control=True), operator) as one:
        yield one


@contextmanager
def opened(browser: Browser, desk: Served, token: str, *tolerated: str) -> Iterator[Page]:
    address = f"{desk.address}#token={token}"
    with watched(browser, address, before=PATIENT, tolerated=(REFUSED, *tolerated)) as page:
        page.wait_for_selector('[data-do="stop"]', state="visible")
        yield page


def wait_for_result(page: Page, words: str) -> None:
    until(page, f"document.querySelector('#order-result').textContent.includes({words!r})")


def test_double_click_does_not_confirm_release(
    browser: Browser, desk: Served, team: Team, operator: Operator
) -> None:
    desk.play()
    with opened(browser, desk, operator.token) as page:
        release = page.locator('[data-do="release"]')
        release.dblclick()
        assert "press again" in (release.text_content() or "")
        assert team.received == []
        release.click()
        wait_for_result(page, "release: 6 of 6 obey")
    assert team.leader_mode() == "hold"  # only the stop is released


def test_outdated_page_may_stop_but_not_release(
    browser: Browser, desk: Served, team: Team, operator: Operator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control, "MAX_SHOWN_AGE", 0.5)
    desk.feed(3)
    with opened(browser, desk, operator.token) as page:
        desk.feed()
        page.wait_for_timeout(1000.0)
        for _ in range(2):
            page.locator('[data-do="release"]').click()
        wait_for_result(page, "REFUSED")
        assert team.received == []
        page.locator('[data-do="stop"]').click()
        wait_for_result(page, "stop: 6 of 6 obey")


def test_page_without_frames_cannot_order_run(
    browser: Browser, desk: Served, team: Team, operator: Operator
) -> None:
    with opened(browser, desk, operator.token) as page:
        for _ in range(2):
            page.locator('[data-do="run"]').click()
        wait_for_result(page, "shows what was long ago")
    assert team.received == []


def test_old_page_gives_no_orders_to_restarted_monitor(
    browser: Browser, team: Team, operator: Operator
) -> None:
    port = int(free_endpoint().rpartition(":")[2])
    with served(Now(6, control=True), operator, port=port) as first:
        first.play()
        with opened(browser, first, operator.token, "net::ERR") as page:  # of the stream that ends
            page.route("**/stream", lambda _: None)  # with a new stream the page would ask for another token
            first.close()
            with served(Now(6, control=True), Operator(SIX, team, lambda _: None), port=port) as second:
                second.play()
                page.locator('[data-do="stop"]').click()
                wait_for_result(page, "the token is not right")
                assert page.locator('[data-do="stop"]').is_hidden()
    assert team.received == []
