"""The live page in a real browser: leader, candidates and placed shape."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from formation.monitor.metrics.snapshot import AVOIDING
from tests.processes.page.scene import Scene
from tests.support.served import Served, served, until, watched

pytestmark = pytest.mark.browser
STANDBYS = ("spare1", "spare2")
CHIPS = "[...document.querySelectorAll('#candidates li')].map((one) => [one.textContent, one.dataset.tone])"

RIGHT_EDGES = (
    "[...document.querySelectorAll('#candidates li')].map((one) => one.getBoundingClientRect().right)"
)


@pytest.fixture
def six() -> Iterator[Served]:
    with served(Scene(6, standbys=STANDBYS)) as one:
        one.play()
        yield one


def test_page_shows_chip_with_state_of_each_candidate(browser: Browser, six: Served) -> None:
    with watched(browser, six.address) as page:
        until(page, f"{CHIPS}[0]?.[0].includes('leads')")
        assert page.evaluate(CHIPS) == [
            ["★ robot1 leads", "good"], ["◇ spare1 standby", "plain"], ["◇ spare2 standby", "plain"],
        ]  # fmt: skip
        six.hush()  # so that one frame has both changes
        six.scene.candidates["robot1"] = ["silent", "no status for 2.6 s", 2.6]
        six.scene.leads = "spare1"
        six.play()
        until(page, f"{CHIPS}[1][0].includes('leads')")
        assert page.evaluate(CHIPS)[:2] == [["✕ robot1 lost", "bad"], ["★ spare1 leads", "good"]]
        assert "2.6 s" in (page.get_attribute("[data-candidate=robot1]", "title") or "")
        assert page.inner_text('[data-robot="robot1"] span.state').endswith("run")
        until(page, "document.getElementById('map').getAttribute('aria-label').includes('spare1 leads')")


def test_page_without_standbys_has_no_chips(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        one.feed(3)
        until(page, "formation.model.frames > 0")
        assert not page.is_visible("#candidates")


def test_page_shows_rotation_scale_and_shape_transition(browser: Browser, six: Served) -> None:
    with watched(browser, six.address) as page:
        until(page, "formation.model.frames > 2")
        assert page.inner_text("#placed-shape") == ""
        six.hush()
        six.scene.rotation, six.scene.scale, six.scene.wedge = math.radians(-30.0), 1.25, 0.5
        six.play()
        until(page, "document.getElementById('placed-shape').textContent !== ''")
        assert page.inner_text("#placed-shape") == "−30° ×1.25"
        assert page.inner_text("#settled") == "shape on its way"
        before = page.evaluate("formation.model.robots[3].slot")
        six.scene.wedge = 1.0
        until(page, "document.getElementById('settled').textContent !== 'shape on its way'")
        after = page.evaluate("formation.model.robots[3].slot")
        assert math.hypot(after["x"] - before["x"], after["y"] - before["y"]) > 0.2


def test_table_shows_unavailable_avoiding_fallback_and_awaited_robots(browser: Browser, six: Served) -> None:
    with watched(browser, six.address) as page:
        six.hush()  # so that one frame has all changes
        six.scene.unavailable.add("robot4")
        six.scene.avoiding = {"robot3": AVOIDING["avoids"], "robot4": AVOIDING["blocked"]}
        six.scene.fallback["robot5"] = "robot2"
        six.scene.waits = "robot4"
        six.play()
        until(page, "document.querySelector('[data-robot=robot4] .reason').textContent !== ''")
        reasons = {name: page.inner_text(f'[data-robot="{name}"] .reason') for name in six.scene.names}
        assert reasons == {
            "robot1": "waits for robot4", "robot2": "", "robot3": "avoids a collision",
            "robot4": "unavailable", "robot5": "follows robot2 instead", "robot6": "",
        }  # fmt: skip
        assert page.get_attribute('[data-robot="robot4"]', "data-tone") == "warn"
        six.scene.unavailable.clear()
        until(page, "document.querySelector('[data-robot=robot4] .reason').textContent.startsWith('stopped')")
        assert page.inner_text('[data-robot="robot4"] .reason') == "stopped by its protective zone"


def test_chips_and_placed_shape_fit_screen_width(browser: Browser) -> None:
    scene = Scene(6, standbys=tuple(f"spare{number}" for number in range(1, 9)))
    scene.rotation, scene.scale, scene.wedge, scene.waits = math.radians(-170.0), 1.234, 0.5, "robot4, robot5"
    with served(scene) as one, watched(browser, one.address) as page:
        one.play()
        until(page, f"{CHIPS}.length === 9")
        for width, height in ((1280, 760), (390, 844)):
            page.set_viewport_size({"width": width, "height": height})
            if width < 1000:
                page.click('[data-shows="robots"]')
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert page.evaluate(f"Math.max(...{RIGHT_EDGES})") <= width
