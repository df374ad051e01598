"""The page of a real `formation replay` of a recording of one minute, in a real browser."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

from formation.monitor.metrics.event import Event, to_message
from formation.ros2.messages import Number, encode
from formation.topics import ERROR, EVENTS
from formation.wire import Sample
from tests.processes.monitor.replayed import Replayed, replaying
from tests.support.monitored import EPOCH, Fleet
from tests.support.served import drawn, until, watched
from tests.unit.monitor.recording.test_recorder import recorder

pytestmark = [pytest.mark.processes, pytest.mark.browser]
BEGIN, LENGTH = 10.0, 60
"""[s]"""
HIT = 0.3
"""Greatest error of a position sought on a slider with steps of 0.1 s [s]."""
REPLAY = "formation.model.frame.replay"
AT = f"{REPLAY}.t - {REPLAY}.start"
CLOCKS = f"[performance.now() / 1000, {AT}]"
"""Clock of the browser and position of the replay [s]."""
MEANWHILE = 10
"""Number of frames for which the position must not change."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Record six robots that drive straight on, with an event every second."""
    path = tmp_path_factory.mktemp("recorded") / "a_minute.mcap"
    samples = Fleet().positions(BEGIN, BEGIN + LENGTH)
    for second in range(LENGTH):
        event = Event(EPOCH + BEGIN + second, 20, "", "told", f"second {second}")
        samples.append(Sample(EVENTS.key(), encode(to_message(event)), None, BEGIN + second))
    for tenth in range(10 * LENGTH):
        samples.append(Sample(ERROR.key(), encode(Number(1.0 / (1 + tenth))), None, BEGIN + tenth / 10))
    with recorder(path) as into:
        for sample in sorted(samples, key=lambda one: one.arrived):
            into.write(sample, sample.arrived + EPOCH)
    return path


@pytest.fixture(scope="module")
def replay(recording: Path) -> Iterator[Replayed]:
    """Start one replay for all tests; the last one kills it."""
    with replaying(recording, "--no-zenoh", "--loop") as one:
        yield one


@contextmanager
def playing(browser: Browser, replay: Replayed, **options: Any) -> Iterator[Page]:
    """Open the page of a replay that plays from its start; yield it as soon as it has a position."""
    replay.steered("speed", 1.0)
    replay.steered("seek", 0.0)
    replay.steered("play")
    with watched(browser, replay.address, **options) as page:
        until(page, f"formation.model.frame && {AT} > 0")
        yield page


def is_still(page: Page) -> bool:
    """Whether the replay is at the same position `MEANWHILE` frames later."""
    frames, before = page.evaluate(f"[formation.model.frames, {AT}]")
    until(page, f"formation.model.frames >= {frames + MEANWHILE}")
    return bool(page.evaluate(AT) == before)


def wait_for_event(page: Page, second: int) -> None:
    """Wait until the newest event is that of this second of the recording."""
    page.locator("#event-list > li").first.filter(has_text=f"second {second}").wait_for()


def test_mouse_pauses_seeks_and_speeds_up_replay(browser: Browser, replay: Replayed) -> None:
    with playing(browser, replay) as page:
        assert page.inner_text("#recording") == "▶ a_minute.mcap"
        page.click("#replay-play")
        page.locator("#connection", has_text="paused").wait_for()
        assert is_still(page)
        drawn(page)
        assert page.inner_text("#replay-play") == "▶ Play"
        assert not page.is_visible("#stale")  # although the picture does not change

        page.locator("#replay-at").fill("20.5")
        until(page, f"Math.abs({AT} - 20.5) < {HIT}")
        page.locator("#replay-time", has_text="0:20 of").wait_for()
        wait_for_event(page, 20)
        assert is_still(page)
        page.locator("#replay-at").fill("3.5")
        until(page, f"Math.abs({AT} - 3.5) < {HIT}")
        wait_for_event(page, 3)
        assert page.locator("#event-list > li").count() == 4  # later events are not shown

        page.select_option("#replay-speed", "10")
        until(page, f"{REPLAY}.speed === 10")
        assert is_still(page)
        page.click("#replay-play")
        until(page, f"{AT} > 4")
        then, before = page.evaluate(CLOCKS)
        until(page, f"{AT} > {before + 6}")
        now, after = page.evaluate(CLOCKS)
        assert after - before > 1.5 * (now - then)
        drawn(page)
        assert page.inner_text("#replay-play") == "Ⅱ Pause"


def test_keyboard_pauses_seeks_and_speeds_up_replay(browser: Browser, replay: Replayed) -> None:
    with playing(browser, replay) as page:
        page.focus("#replay-play")
        page.keyboard.press("Space")
        page.locator("#connection", has_text="paused").wait_for()
        assert is_still(page)
        page.keyboard.press("Tab")
        page.keyboard.press("2")  # the first character of the option
        until(page, f"{REPLAY}.speed === 2")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.id") == "replay-at"
        page.keyboard.press("End")
        until(page, f"{REPLAY}.end - {REPLAY}.t < {HIT}")
        page.keyboard.press("Home")
        until(page, f"{AT} < {HIT}")
        page.keyboard.press("PageUp")
        until(page, f"{AT} > 1")
        assert is_still(page)
        page.focus("#replay-play")
        page.keyboard.press("Enter")
        here = page.evaluate(AT)
        until(page, f"{AT} > {here} + 1")


def test_page_of_paused_replay_reports_its_death(browser: Browser, replay: Replayed) -> None:
    with playing(browser, replay, tolerated="net::ERR") as page:
        page.click("#replay-play")
        page.locator("#connection", has_text="paused").wait_for()
        replay.process.kill()
        page.wait_for_selector("#stale", state="visible")
        assert page.inner_text("#stale").startswith("✕ THE REPLAY HAS STOPPED.")
