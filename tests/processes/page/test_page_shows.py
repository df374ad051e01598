"""The live page in a real browser: what it shows, and that it marks old data."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.processes.page.scene import PERIOD, Scene, event
from tests.support.child import PATIENCE, free_endpoint
from tests.support.served import NO_SNAPSHOT, Served, drawn, served, until, watched

pytestmark = pytest.mark.browser
SIX = 6
WHEN_STALE = """() => {
  new MutationObserver(() => {
    globalThis.staleAt ??= formation.stream.age;
  }).observe(document.getElementById('stale'), {attributes: true});
  let last = performance.now();
  globalThis.heldUp = 0;
  setInterval(() => {
    const now = performance.now();
    globalThis.heldUp = Math.max(globalThis.heldUp, (now - last) / 1000 - 0.1);
    last = now;
  }, 100);
}"""
"""Records the age of the newest frame when it is marked as stale, and the longest delay of a timer [s]."""
NO_MEMORY = """for (const store of ['localStorage', 'sessionStorage']) {
  Object.defineProperty(window, store, {get() { throw new DOMException('forbidden', 'SecurityError'); }});
}"""
ROW = '[data-robot="{}"]'


@pytest.fixture
def six() -> Iterator[Served]:
    with served(Scene(SIX)) as one:
        one.play()
        yield one


def test_page_shows_moving_robots_and_falling_error(browser: Browser) -> None:
    with served(Scene(SIX)) as six, watched(browser, six.address) as page:
        six.feed()
        until(page, "formation.model.frame")
        drawn(page)
        before = page.evaluate("formation.model.robots.map((robot) => [robot.place.x, robot.place.y])")
        picture = page.evaluate("document.getElementById('map').toDataURL()")
        error = page.evaluate("formation.model.frame.error")
        six.feed(20)
        until(page, f"formation.model.frame.error < {0.5 * error}")
        drawn(page)
        after = page.evaluate("formation.model.robots.map((robot) => [robot.place.x, robot.place.y])")
        assert all(one != other for one, other in zip(before, after, strict=True))
        assert page.evaluate("document.getElementById('map').toDataURL()") != picture
        assert page.inner_text("#error").endswith(" m")
        assert page.inner_text("#mission") == "6-robots"
        assert page.locator("#robot-rows tr").count() == SIX
        six.play()
        page.locator("#connection", has_text="live").wait_for()


def test_unknown_error_marks_settled_time_as_past(browser: Browser) -> None:
    with served(Scene(SIX)) as one, watched(browser, one.address) as page:
        verdict = {"settled_at": 3.6, "converged": True}  # still set when the error becomes unknown
        one.source.show({**one.scene.step(), **verdict, "error": 0.001}, NO_SNAPSHOT)
        page.locator('#error[data-tone="good"]').wait_for()
        assert page.inner_text("#settled") == "at 3.6 s"
        one.source.show({**one.scene.step(), **verdict, "error": None}, NO_SNAPSHOT)
        page.locator('#error[data-tone="bad"]', has_text="unknown").wait_for()
        assert page.inner_text("#settled") == "was, at 3.6 s"


def test_page_shows_lost_robot_with_age(browser: Browser, six: Served) -> None:
    with watched(browser, six.address) as page:
        until(page, "formation.model.frames > 3")
        six.scene.silent["robot5"] = six.scene.time
        row = page.locator(ROW.format("robot5"))
        row.locator("td.state", has_text="lost").wait_for()
        assert " s" in row.locator("td.age").inner_text()
        share = row.locator(".health-share")
        assert "health 0 %: no position for" in (share.get_attribute("aria-label") or "")
        assert (share.inner_text(), row.locator(".battery").count()) == ("0 %", 0)
        assert page.evaluate("formation.model.robots[4].place !== null")  # drawn at its last place
        page.locator('#map[aria-label*="lost: robot5"]').wait_for()
        edges = six.scene.edges
        known = sum(six.scene.names.index("robot5") not in edge for edge in edges)
        page.locator("#true-error", has_text=f"{known} of {len(edges)} edges").wait_for()
        assert page.inner_text("#error") != "unknown"
        del six.scene.silent["robot5"]
        row.locator("td.state", has_text="run").wait_for()


def test_saturated_command_is_marked_max(browser: Browser) -> None:
    with served(Scene(SIX)) as still, watched(browser, still.address) as page:
        still.feed()
        until(page, "formation.model.frame")
        saturated = page.evaluate(
            "formation.model.robots.filter((one) => one.command('turn_rate').saturated).map(({name}) => name)"
        )
        assert saturated
        for name in saturated:
            mark = page.locator(ROW.format(name)).locator("td.turn_rate .bar-mark")
            mark.filter(has_text="max").wait_for()


def test_stale_page_is_marked_quickly_and_recovers(browser: Browser, six: Served) -> None:
    with watched(browser, six.address) as page:
        until(page, "formation.model.frames > 3")
        page.wait_for_selector("#stale", state="hidden")
        page.evaluate(WHEN_STALE)
        six.hush()
        page.wait_for_selector("#stale", state="visible")
        assert 1.5 <= page.evaluate("staleAt") < 2.0 + page.evaluate("heldUp")
        result, age = page.evaluate("[document.querySelector('#stale-age').innerText, formation.stream.age]")
        assert float(result.removesuffix(" s")) == pytest.approx(age, abs=1.0)
        assert "grayscale" in page.evaluate("getComputedStyle(document.querySelector('main')).filter")
        assert "no data" in page.inner_text("#connection")
        six.play()
        page.wait_for_selector("#stale", state="hidden")
        page.locator("#connection", has_text="live").wait_for()


def test_page_reconnects_to_restarted_server(browser: Browser) -> None:
    port = int(free_endpoint().rpartition(":")[2])
    with served(Scene(SIX), port=port) as first:
        first.play()
        with watched(browser, first.address, tolerated="net::ERR") as page:
            until(page, "formation.model.frames > 3")
            first.close()
            page.wait_for_selector("#stale", state="visible")
            page.locator("#connection", has_text="reconnecting").wait_for()
            with served(Scene(SIX), port=port) as second:
                second.play()
                page.wait_for_selector("#stale", state="hidden")
                until(page, "formation.model.frame.elapsed < 20")
                page.locator("#connection", has_text="live").wait_for()
                assert page.locator("#robot-rows tr").count() == SIX


def test_page_reconnects_when_open_stream_is_silent(browser: Browser, six: Served) -> None:
    with watched(browser, six.address) as page:
        until(page, "formation.model.frames > 3")
        six.hush()  # the connection stays open
        six.scene.time += 10.0
        dialled = page.evaluate("formation.stream.dialled")
        until(page, f"formation.stream.dialled > {dialled}")
        until(page, "formation.stream.open")
        assert page.evaluate("formation.stream.age") > 5.0  # the frame in the greeting is old
        assert page.is_visible("#stale")
        six.play()
        page.wait_for_selector("#stale", state="hidden")


def test_page_opened_while_monitor_hangs_waits_for_data(browser: Browser, six: Served) -> None:
    six.hush()
    six.feed()
    six.scene.time += 10.0
    with watched(browser, six.address) as page:
        until(page, "formation.stream.open")
        assert page.evaluate("formation.model.frame") is None
        page.locator("#connection", has_text="waiting for data").wait_for()
        six.play()
        until(page, "formation.model.frame")
        page.locator("#connection", has_text="live").wait_for()


def test_events_are_listed_newest_first_and_filtered(browser: Browser, six: Served) -> None:
    six.note(event(0, 0.0, "joined", "robot2", "joined"))
    with watched(browser, six.address) as page:
        six.note(event(1, 1.0, "lost", "robot5", "no position for 1.0 s", 40))
        six.note(event(2, 2.0, "held", "robot3", "no neighbour is fresh", 30))
        items = page.locator("#event-list li")
        items.nth(2).wait_for()
        assert [text.splitlines()[-1] for text in items.all_inner_texts()] == [
            "robot3: no neighbour is fresh", "robot5: no position for 1.0 s", "robot2: joined",
        ]  # fmt: skip
        assert page.get_attribute("#event-list", "aria-live") == "polite"
        page.check("#event-warnings")
        assert items.count() == 2
        page.fill("#event-filter", "robot5")
        assert items.count() == 1
        assert items.locator('[role="img"]').get_attribute("aria-label") == "error"


def test_table_of_hundred_robots_sorts_and_filters(browser: Browser) -> None:
    with served(Scene(100)) as crowd, watched(browser, crowd.address) as page:
        crowd.scene.silent["robot42"] = 0.0
        crowd.play()
        first = page.locator("#robot-rows tr").first
        first.filter(has_text="robot42").wait_for()
        assert "1 lost" in page.inner_text("#robot-count")
        _check_sticky_header(page)
        page.click('th[data-sort="name"] button')
        first.filter(has_text="robot1").wait_for()
        assert page.get_attribute('th[data-sort="name"]', "aria-sort") == "ascending"
        page.fill("#robot-filter", "robot77")
        until(
            page, "[...document.querySelectorAll('#robot-rows tr')].filter((row) => !row.hidden).length === 1"
        )
        deadline = time.monotonic() + PATIENCE
        while not _keeps_up(page, crowd):
            assert time.monotonic() < deadline


def _check_sticky_header(page: Page) -> None:
    """Check in one evaluation that the header stays in place while the rows scroll."""
    scrolled, moved = page.evaluate("""() => {
      const header = document.querySelector('#robot-table th');
      const rows = document.querySelector('#robots .scroll');
      const before = header.getBoundingClientRect().top;
      rows.scrollTop = 500;
      return [rows.scrollTop, header.getBoundingClientRect().top - before];
    }""")
    assert (scrolled, moved) == (500, 0)


def _keeps_up(page: Page, crowd: Served) -> bool:
    """Whether the page takes more than half of the next ten frames."""
    made, taken = crowd.scene.time, page.evaluate("formation.model.frames")
    while crowd.scene.time < made + 9.5 * PERIOD:
        page.wait_for_timeout(20)
    return bool(page.evaluate("formation.model.frames") > taken + 5)


def test_page_works_without_browser_storage(browser: Browser, six: Served) -> None:
    with watched(browser, six.address, before=NO_MEMORY) as page:
        until(page, "formation.model.frames > 3")
        page.click("#log-scale")
        page.click("#theme")
        assert page.locator("#robot-rows tr").count() == SIX
