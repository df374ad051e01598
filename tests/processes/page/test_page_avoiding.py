"""The page draws posts and walls on the map, and shows avoiding robots in the table."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from formation.monitor.metrics.snapshot import AVOIDING
from tests.processes.page.scene import Scene
from tests.support.served import served, until, watched

pytestmark = pytest.mark.browser
PIXELS = """((places) => {
  const {camera, canvas, pen, requested} = formation.view, dots = canvas.width / canvas.clientWidth;
  const pixel = ([x, y]) => [...pen.getImageData(dots * camera.sx(x), dots * camera.sy(y), 1, 1).data].join();
  return camera.placed && !requested && places.map(pixel);
})"""
"""Returns the pixels at some places once all is drawn: setting the size of a canvas empties it."""


def test_map_draws_posts_and_walls_in_place(browser: Browser) -> None:
    found = {}
    for things in (True, False):
        scene = Scene(6)
        if things:
            scene.posts, scene.walls = [[-1.0, 0.3, 0.15]], [[-1.5, -0.4, -0.5, -0.4]]
        with served(scene) as one, watched(browser, one.address, tolerated="Canvas2D") as page:
            one.feed(3)
            found[things] = until(page, f"{PIXELS}([[-1.0, 0.33], [-1.1, -0.4]])")
    assert found[True][0] == found[True][1]
    assert not set(found[True]) & set(found[False])


def test_row_shows_avoiding_blocked_and_unavailable_robot(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        one.scene.avoiding = {"robot3": AVOIDING["avoids"], "robot4": AVOIDING["blocked"]}
        one.scene.unavailable.add("robot4")
        one.play()
        until(page, "document.querySelector('[data-robot=robot3] .reason').textContent !== ''")
        assert page.inner_text('[data-robot="robot3"] .reason') == "avoids a collision"
        assert page.inner_text('[data-robot="robot4"] .reason') == "unavailable"
        one.scene.unavailable.clear()
        until(page, "document.querySelector('[data-robot=robot4] .reason').textContent.startsWith('stopped')")
        assert page.inner_text('[data-robot="robot4"] .reason') == "stopped by its protective zone"
