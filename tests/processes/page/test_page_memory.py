"""A page that is left open does not grow."""

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
"""Minutes after which all that the page keeps (errors, trails, events) is as long as it gets."""
AT_ONCE = 50
"""Frames made before the page is asked whether it has taken them."""


class Size(NamedTuple):
    """What a page takes up, after its garbage was collected."""

    heap: int
    """[bytes]"""
    nodes: int
    """Of the document and of what was taken out of it and is still held."""
    listeners: int


def size(page: Page, debugger: CDPSession) -> Size:
    """The least of some, for now and then a picture is just being made."""
    return min(once(page, debugger) for _ in range(5))


def once(page: Page, debugger: CDPSession) -> Size:
    page.wait_for_timeout(200)
    debugger.send("HeapProfiler.collectGarbage")
    counted = debugger.send("Memory.getDOMCounters")
    heap = debugger.send("Runtime.getHeapUsage")["usedSize"]
    return Size(heap, counted["nodes"], counted["jsEventListeners"])


def feed(page: Page, one: Served, minutes: float) -> None:
    """As fast as the page takes it; something happens twice a second."""
    taken, wanted = 0, round(minutes * MINUTE)
    before = page.evaluate("formation.model.frames")
    while taken < wanted:
        one.feed()
        number = round(10 * one.scene.time)
        if number % 5 == 0:
            level = 20 + 10 * (number % 3)
            one.note(event(number, one.scene.time, "held", "robot2", f"for the {number}th time", level))
        if number % AT_ONCE == 0:
            taken = page.evaluate("formation.model.frames") - before


@pytest.mark.timeout(240)
def test_page_with_full_lists_does_not_grow(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        debugger = page.context.new_cdp_session(page)
        feed(page, one, FULL)
        early = size(page, debugger)
        feed(page, one, 6)
        late = size(page, debugger)
        assert page.locator("#event-list li").count() == 200
    # What is left is the browser's: it goes on compiling what is called often. 3600 frames, 55 bytes of each.
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


def test_lists_that_are_full_keep_the_newest_in_their_order(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        points, times, values = page.evaluate(RINGS)
    assert points == [[97, -97], [98, -98], [99, -99]]
    assert 10 <= len(times) <= 12
    assert times == list(range(100 - len(times), 100))
    assert values == [2 * time for time in times]
