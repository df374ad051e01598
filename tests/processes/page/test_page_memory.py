"""The memory of a page that stays open does not grow."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from playwright.sync_api import Browser, CDPSession, Page

from tests.processes.page.scene import Scene, event
from tests.support.served import Served, served, watched

pytestmark = pytest.mark.browser
MINUTE = 600
"""Frames."""
FULL = 12
"""Minutes after which all lists of the page (errors, trails, events) are full."""
FRAMES_AT_ONCE = 50
"""Frames that are made between two questions to the page how many it has taken."""


class Size(NamedTuple):
    """Memory of a page after garbage collection."""

    heap: int
    """[bytes]"""
    nodes: int
    """DOM nodes in the document, and removed ones that are still referenced."""
    listeners: int


def least_size(page: Page, debugger: CDPSession) -> Size:
    """Least of several measurements, as the page may be drawing during one."""
    return min(measured_once(page, debugger) for _ in range(5))


def measured_once(page: Page, debugger: CDPSession) -> Size:
    page.wait_for_timeout(200)
    debugger.send("HeapProfiler.collectGarbage")
    counted = debugger.send("Memory.getDOMCounters")
    heap = debugger.send("Runtime.getHeapUsage")["usedSize"]
    return Size(heap, counted["nodes"], counted["jsEventListeners"])


def feed(page: Page, one: Served, minutes: float) -> None:
    """Send frames as fast as the page takes them, with two events per second."""
    taken, wanted = 0, round(minutes * MINUTE)
    before = page.evaluate("formation.model.frames")
    while taken < wanted:
        one.feed()
        number = round(10 * one.scene.time)
        if number % 5 == 0:
            level = 20 + 10 * (number % 3)
            one.note(event(number, one.scene.time, "held", "robot2", f"for the {number}th time", level))
        if number % FRAMES_AT_ONCE == 0:
            taken = page.evaluate("formation.model.frames") - before


@pytest.mark.timeout(240)
def test_page_with_full_lists_does_not_grow(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        debugger = page.context.new_cdp_session(page)
        feed(page, one, FULL)
        early = least_size(page, debugger)
        feed(page, one, 6)
        late = least_size(page, debugger)
        assert page.locator("#event-list li").count() == 200
    # The browser still compiles functions that are called often: 3600 frames, 55 bytes for each.
    assert late.heap - early.heap < 200_000
    assert late.nodes <= early.nodes + 100
    assert late.listeners <= early.listeners + 5


RINGS = """async () => {
  const { Series, Trail } = await import('./script/ring.js');
  const [trail, series, seen] = [new Trail(3), new Series(10, 1), []];
  for (let n = 0; n < 100; n += 1) {
    trail.push(n, -n);
    series.push(n, 2 * n);
  }
  trail.each((x, y) => seen.push([x, y]));
  return [seen, series.times, series.values];
}"""


def test_full_lists_keep_newest_in_order(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        points, times, values = page.evaluate(RINGS)
    assert points == [[97, -97], [98, -98], [99, -99]]
    assert 10 <= len(times) <= 12
    assert times == list(range(100 - len(times), 100))
    assert values == [2 * time for time in times]
