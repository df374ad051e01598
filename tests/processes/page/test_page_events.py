"""The page's list of events folds similar events of many robots into one line."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.processes.page.scene import Scene, event
from tests.support.served import Served, served, watched

pytestmark = pytest.mark.browser
CROWD = 100


@pytest.fixture
def desk() -> Iterator[Served]:
    """A page of six robots with one frame."""
    with served(Scene(6)) as one:
        one.feed()
        yield one


def note_start(desk: Served) -> None:
    """Note an order of the leader; then a hundred robots join and run within one second."""
    desk.note(event(0, 0.0, "order", "", "the leader orders run, shape hexagon"))
    for n in range(CROWD):
        desk.note(event(1 + 2 * n, 0.009 * n, "joined", f"robot{n + 1}", "its position is received"))
        reason = f"in formation control, {n + 1} of {CROWD}"
        desk.note(event(2 + 2 * n, 0.009 * n, "runs", f"robot{n + 1}", reason))


def rows(page: Page) -> list[str]:
    """Text of each line, without its folded details."""
    texts: list[str] = page.locator("#event-list > li > .text").evaluate_all(
        "(texts) => texts.map((one) => (one.querySelector('summary') ?? one).textContent)"
    )
    return texts


def test_events_of_hundred_robots_fold_into_two_lines(browser: Browser, desk: Served) -> None:
    note_start(desk)
    with watched(browser, desk.address) as page:
        assert rows(page) == [
            "robot1, robot2 and 98 more",
            "robot1, robot2 and 98 more: its position is received",
            "the leader orders run, shape hexagon",
        ]
        page.click("#event-list summary")
        page.locator("#event-list details li", has_text="robot77: in formation control, 77 of").wait_for()
        page.fill("#event-filter", "robot42")
        assert rows(page) == ["robot42: in formation control, 42 of 100", "robot42: its position is received"]
        page.fill("#event-filter", "joined")
        assert rows(page) == ["robot1, robot2 and 98 more: its position is received"]


def test_open_line_grows_with_new_events_and_stays_open(browser: Browser, desk: Served) -> None:
    for n in range(3):
        desk.note(event(n, 0.1 * n, "joined", f"robot{n + 1}", "heard"))
    with watched(browser, desk.address) as page:
        assert rows(page) == ["robot1, robot2 and 1 more: heard"]
        page.click("#event-list summary")
        desk.note(event(3, 0.9, "joined", "robot4", "heard"))
        page.locator("#event-list details[open] li", has_text="robot4").wait_for()
        assert rows(page) == ["robot1, robot2 and 2 more: heard"]
        desk.note(event(4, 1.1, "joined", "robot5", "heard"))
        page.locator("#event-list > li", has_text="robot5").wait_for()
        assert rows(page) == ["robot5: heard", "robot1, robot2 and 2 more: heard"]


def test_errors_warnings_and_team_events_keep_own_lines(browser: Browser, desk: Served) -> None:
    reported = [
        event(0, 0.0, "lost", "robot2", "silent for 1.0 s", 40),
        event(1, 0.1, "lost", "robot3", "silent for 1.1 s", 40),
        event(2, 0.2, "lost", "robot4", "last state: stop", 30),
        *(event(n, 0.1 * n, "operator", "", f"order {n}") for n in (3, 4, 5)),
        *(event(n, 0.1 * n, "held", "robot6", f"for the {n}th time", 30) for n in (6, 7, 8)),
    ]
    for one in reported:
        desk.note(one)
    with watched(browser, desk.address) as page:
        expected = [f"{one['robot']}: {one['text']}" if one["robot"] else one["text"] for one in reported]
        assert rows(page) == expected[::-1]
