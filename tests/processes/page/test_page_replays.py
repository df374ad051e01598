"""A replay on the page: name of the recording, remarks, slider, and missing frames."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.processes.page.scene import EPOCH, Scene
from tests.support.child import free_endpoint
from tests.support.served import Served, drawn, served, until, watched

pytestmark = pytest.mark.browser
LONG = "/home/somebody/recordings/" + "a_name_that_is_rather_long_" * 4 + ".mcap"


@pytest.fixture
def played() -> Iterator[Served]:
    """The page of a replay; the test sends its frames."""
    with served(Scene(6, live=False)) as one:
        one.source.tell(recording="/home/somebody/recordings/run.mcap")
        one.feed()
        yield one


def test_page_names_replayed_recording(browser: Browser, played: Served) -> None:
    with watched(browser, played.address) as page:
        page.locator("#recording", has_text="run.mcap").wait_for()
        until(page, "formation.model.frames > 0")
        assert page.inner_text("#recording") == "▶ run.mcap"
        assert page.get_attribute("#recording", "title") == "played: /home/somebody/recordings/run.mcap"
        assert not page.inner_text("#recording-size")


def test_long_recording_name_and_remarks_fit(browser: Browser, played: Served) -> None:
    played.source.tell(recording=LONG)
    played.scene.replay |= {"counted_from": EPOCH + 3599.0, "drift": 1234.5, "skipped": 1_234_567}
    with watched(browser, played.address) as page:
        played.feed()
        page.locator("#replay-remarks", has_text="1234567").wait_for()
        for width in (360, 390, 1000, 1280):
            page.set_viewport_size({"width": width, "height": 740})
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            for part in ("#recording", "#replay", "#replay-remarks", "#connection"):
                box = page.locator(part).bounding_box()
                assert box is not None
                assert box["x"] + box["width"] <= width, (width, part)


def test_page_shows_seeking_remarks_and_end(browser: Browser, played: Served) -> None:
    with watched(browser, played.address) as page:
        page.locator('#replay[aria-busy="false"]').wait_for()
        assert not page.is_visible("#replay-remarks")
        played.scene.replay |= {"seeking": True, "paused": True}
        played.feed()
        page.locator("#connection", has_text="seeking").wait_for()
        page.locator('#replay[aria-busy="true"]').wait_for()
        played.scene.replay |= {"seeking": False, "counted_from": EPOCH + 65.0, "drift": 2.34, "skipped": 17}
        played.feed()
        page.locator("#connection", has_text="paused").wait_for()
        drawn(page)
        assert page.inner_text("#replay-remarks") == (
            "▲ settling, elapsed time and counts since 1:05 only · 2.3 s late"
            " · 17 messages came too late to be published"
        )
        played.scene.replay |= {"finished": True}
        played.feed()
        page.locator("#connection", has_text="at its end").wait_for()
        drawn(page)
        assert "Play" in page.inner_text("#replay-play")


def test_replay_without_new_frames_is_shown_as_stopped(browser: Browser, played: Served) -> None:
    with watched(browser, played.address) as page:
        page.wait_for_selector("#stale", state="visible")
        assert page.inner_text("#stale").startswith("✕ THE REPLAY HAS STOPPED.")
        played.play()
        page.wait_for_selector("#stale", state="hidden")


def test_frames_before_seek_do_not_move_slider(browser: Browser) -> None:
    scene = Scene(6, live=False)
    scene.replay |= {"end": EPOCH + 60.0, "paused": True, "seeks": 0}
    with served(scene, steer=lambda _do, _to: {"seeks": 1}) as one, watched(browser, one.address) as page:
        one.feed()
        until(page, "formation.model.frames > 0")
        drawn(page)  # the first picture sets the slider
        page.locator("#replay-at").fill("20")
        for _ in range(3):
            seen = page.evaluate("formation.model.frames")
            one.feed()
            until(page, f"formation.model.frames > {seen}")
            drawn(page)
            assert page.input_value("#replay-at") == "20"
        scene.replay |= {"seeks": 1, "t": EPOCH + 7.0}
        one.feed()
        until(page, "document.getElementById('replay-at').value === '7'")


def test_slider_follows_restarted_replay(browser: Browser) -> None:
    """A restarted replay counts its seeks from 0 again."""
    port = int(free_endpoint().rpartition(":")[2])
    scene = Scene(6, live=False)
    scene.replay |= {"paused": True, "seeks": 0}
    value = "document.getElementById('replay-at').value"
    with served(scene, steer=lambda _do, _to: {"seeks": 5}, port=port) as first:
        first.feed()
        with watched(browser, first.address, tolerated="net::ERR") as page:
            until(page, "formation.model.frames > 0")
            with page.expect_response("**/api/replay"):
                page.locator("#replay-at").fill("20")
            first.close()
            scene.replay |= {"t": EPOCH + 7.0}
            with served(scene, port=port) as second:
                second.play()
                until(page, f"{value} === '7'")


def test_paused_replay_does_not_become_stale(browser: Browser, played: Served) -> None:
    played.scene.replay["paused"] = True
    played.feed()
    with watched(browser, played.address) as page:
        until(page, "formation.stream.age > 2.0")
        until(page, "document.getElementById('connection').textContent.includes('paused')")
        assert not page.is_visible("#stale")
