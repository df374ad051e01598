"""What befalls many robots at once is one line of the page's list of events."""

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
    """Six robots, of which little is shown."""
    with served(Scene(6)) as one:
        one.feed()
        yield one


def begin(desk: Served) -> None:
    """A hundred robots join and run, all within a second; the leader has ordered it before."""
    desk.note(event(0, 0.0, "order", "", "the leader orders run, shape hexagon"))
    for n in range(CROWD):
        desk.note(event(1 + 2 * n, 0.009 * n, "joined", f"robot{n + 1}", "its position is received"))
        reason = f"in formation control, {n + 1} of {CROWD}"
        desk.note(event(2 + 2 * n, 0.009 * n, "runs", f"robot{n + 1}", reason))


def rows(page: Page) -> list[str]:
    """What stands in each line, whatever can be opened in it left out."""
    texts: list[str] = page.locator("#event-list > li > .text").evaluate_all(
        "(texts) => texts.map((one) => (one.querySelector('summary') ?? one).textContent)"
    )
    return texts


def test_a_hundred_robots_that_begin_are_two_lines_and_hide_nothing(browser: Browser, desk: Served) -> None:
    begin(desk)
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


def test_a_line_grows_while_they_come_and_stays_open(browser: Browser, desk: Served) -> None:
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


def test_serious_or_formation_events_keep_own_lines(browser: Browser, desk: Served) -> None:
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
