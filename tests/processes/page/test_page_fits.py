"""The live page fits every screen, has enough contrast and works without a mouse."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import pytest
from playwright.sync_api import Browser, Page

from tests.processes.page.asking import DriveRecorder
from tests.processes.page.scene import Scene, event
from tests.support.served import NO_SNAPSHOT, Served, served, until, watched

pytestmark = pytest.mark.browser
WIDTHS = ((360, 740), (390, 844), (820, 1180), (1024, 768), (1280, 800), (1920, 1080), (3840, 2160))
TABS = ("map", "robots", "events")
LEAST_CONTRAST = 4.5
"""Least contrast of text by WCAG 2, level AA."""
STICKS_OUT = """() => {
  const wide = document.documentElement.clientWidth;
  const seen = (element) => element.checkVisibility() && !element.closest('.unseen, .skip, option, .uplot');
  return [...document.body.querySelectorAll('*')].filter(seen)
    .filter((element) => element.getBoundingClientRect().right > wide + 0.5
      || (element.matches('.scroll, .panel, table') && element.scrollWidth > element.clientWidth + 1))
    .map((element) => element.outerHTML.slice(0, 80));
}"""
CONTRASTS = """() => {
  const rgba = (text) => [...text.match(/[\\d.]+/g).map(Number), 1].slice(0, 4);
  const light = ([r, g, b]) => [r, g, b].map((c) => c / 255)
    .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4))
    .reduce((sum, c, n) => sum + [0.2126, 0.7152, 0.0722][n] * c, 0);
  const behind = (element) => {
    for (let one = element; one; one = one.parentElement) {
      const colour = rgba(getComputedStyle(one).backgroundColor);
      if (colour[3] === 1) return colour;
    }
    return [255, 255, 255, 1];
  };
  const ratio = (one, other) => {
    const [a, b] = [light(one) + 0.05, light(other) + 0.05];
    return Math.max(a, b) / Math.min(a, b);
  };
  const worded = [...document.body.querySelectorAll('*')].filter((element) => element.checkVisibility()
    && !element.closest('.unseen, .skip, .uplot, noscript, script')
    && [...element.childNodes].some((node) => node.nodeType === 3 && node.data.trim()));
  return worded.map((element) => [
    ratio(rgba(getComputedStyle(element).color), behind(element)), element.outerHTML.slice(0, 90),
  ]);
}"""


class NoAnswer(DriveRecorder):
    """Accepts orders that no robot answers."""

    token = "secret"  # noqa: S105 - it protects nothing

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Return a report as `formation order --json` prints it."""
        del what, click, seen
        return {"do": do, "acknowledged": [], "refused": [], "missing": ["robot1"], "why": "nobody is there"}


@pytest.fixture(scope="module")
def crowd() -> Iterator[Served]:
    """A page of thirty robots in different states, without new frames."""
    scene = Scene(30, control=True)
    with served(scene, NoAnswer()) as one:
        one.feed(12)
        scene.silent["robot5"] = scene.time
        scene.state["robot3"] = ("hold", "no neighbour is fresh: robot1 0.31 s, robot2 0.25 s")
        scene.state["robot4"] = ("stop", "stopped by the operator")
        one.feed(12)
        for number, level in enumerate((20, 30, 40)):
            one.note(
                event(number, 1.0 + number, "contested", "robot7", "it has a second publisher " * 4, level)
            )
        yield one


def opened(browser: Browser, crowd: Served, **context: Any) -> Any:
    return watched(browser, f"{crowd.address}#token=secret", **context)


def tabs(page: Page, width: int) -> Iterator[str]:
    """Show each tab of a narrow page in turn; a wide page shows all at once."""
    for tab in TABS if width < 1000 else TABS[:1]:
        if width < 1000:
            page.click(f'[data-shows="{tab}"]')
        yield tab


def test_page_fits_every_screen(browser: Browser, crowd: Served) -> None:
    with opened(browser, crowd) as page:
        page.locator("#robot-rows .reason", has_text="fresh").wait_for(state="attached")
        for width, height in WIDTHS:
            page.set_viewport_size({"width": width, "height": height})
            for tab in tabs(page, width):
                page.click('[data-do="stop"]')
                page.locator("#acknowledgements li", has_text="NO ANSWER").wait_for()
                assert page.evaluate(STICKS_OUT) == [], (width, tab)
                assert page.evaluate("document.documentElement.scrollHeight <= innerHeight"), (width, tab)


def test_longest_names_and_reasons_fit(browser: Browser) -> None:
    scene = Scene(6, control=True)
    long = "x" * 64
    hello = scene.hello() | {"mission": long, "shapes": {long: [], "line": []}}
    hello["robots"][2]["name"] = long
    scene.hello = lambda: hello  # type: ignore[method-assign]
    scene.state["robot4"] = ("readonly: would hold", "no two odometry messages within 0.15 s " * 4)
    with served(scene, NoAnswer()) as one, watched(browser, f"{one.address}#token=secret") as page:
        one.feed(5)
        page.locator('[data-robot="robot4"] .reason', has_text="odometry").wait_for(state="attached")
        for width in (360, 1280):
            page.set_viewport_size({"width": width, "height": 800})
            for tab in tabs(page, width):
                assert page.evaluate(STICKS_OUT) == [], (width, tab)


def test_longest_figures_fit(browser: Browser) -> None:
    scene = Scene(6, control=True)
    long = scene.frame() | {
        "elapsed": 35999.0, "error": 88.88, "true": 88.88, "settled_at": 35999.9, "converged": True,
        "mode": "stop", "missed": 99999, "rejected": 9999,
    }  # fmt: skip
    long["recording"] |= {"seconds": 35999.0, "bytes": 987_654_321, "failure": "No space left on device"}
    with served(scene, NoAnswer()) as one, watched(browser, one.address) as page:
        one.source.show(long, NO_SNAPSHOT)
        page.locator("#elapsed", has_text="9:59:59").wait_for()
        assert page.is_visible("#token-form")
        for width in (360, 390, 1000, 1280):
            page.set_viewport_size({"width": width, "height": 740})
            assert page.evaluate(STICKS_OUT) == [], width


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_has_enough_contrast(browser: Browser, crowd: Served, scheme: Literal["light", "dark"]) -> None:
    with opened(browser, crowd, color_scheme=scheme) as page:
        page.locator("#robot-rows .reason", has_text="fresh").wait_for(state="attached")
        page.click('[data-do="stop"]')
        page.locator("#acknowledgements li", has_text="NO ANSWER").wait_for()
        page.evaluate("formation.model.choose('robot2')")
        page.evaluate("document.getElementById('recording-failure').hidden = false")
        for width, height, do in ((390, 844, "run"), (1280, 800, "release")):
            page.set_viewport_size({"width": width, "height": height})
            page.click(f'[data-do="{do}"]')  # shows the request for a second click
            for tab in tabs(page, width):
                measured = page.evaluate(CONTRASTS)
                assert len(measured) > 10
                assert [one for one in measured if one[0] < LEAST_CONTRAST] == [], (width, tab)
        dark = page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(13, 18, 22)"
        assert dark == (scheme == "dark")


def test_theme_button_changes_colours_and_is_remembered(browser: Browser, crowd: Served) -> None:
    colour = "getComputedStyle(document.body).backgroundColor"
    with opened(browser, crowd, color_scheme="light") as page:
        light = page.evaluate(colour)
        page.click("#theme")  # sets light
        assert page.evaluate(colour) == light
        page.click("#theme")
        assert page.evaluate(colour) != light
        page.reload()
        until(page, "globalThis.formation?.model.hello")
        assert page.evaluate(colour) != light


def test_tab_key_reaches_every_control_with_visible_focus(browser: Browser, crowd: Served) -> None:
    with opened(browser, crowd) as page:
        page.locator("#robot-rows .reason", has_text="fresh").wait_for(state="attached")
        wanted = page.evaluate(
            "[...document.querySelectorAll('a[href], button, input, select, [tabindex=\"0\"]')]"
            ".filter((one) => one.checkVisibility()).length"
        )
        reached = set()
        for _ in range(wanted + 5):
            page.keyboard.press("Tab")
            name, outline = page.evaluate(
                "((one) => [one.outerHTML.slice(0, 120), getComputedStyle(one).outlineStyle])"
                "(document.activeElement)"
            )
            reached.add(name)
            assert outline == "solid" or name.startswith("<body"), name
        assert len({name for name in reached if not name.startswith("<body")}) >= wanted


def test_first_tab_offers_skip_link_to_robots(browser: Browser, crowd: Served) -> None:
    with opened(browser, crowd) as page:
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.className") == "skip"
        page.keyboard.press("Enter")
        assert page.evaluate("document.activeElement.id") == "robots"
