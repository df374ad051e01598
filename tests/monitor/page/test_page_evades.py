"""What stands about is on the map where it is known, and who gets out of its way says so in the table."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from monitor.figures.snapshot import EVADES
from tests.monitor.page.scene import Scene
from tests.monitor.page.served import served, until, watched

pytestmark = pytest.mark.browser
PIXEL = """(([x, y]) => {
  const {camera, canvas, pen} = formation.view, dots = canvas.width / canvas.clientWidth;
  return [...pen.getImageData(dots * camera.sx(x), dots * camera.sy(y), 1, 1).data].join();
})"""


def test_posts_and_walls_are_drawn_where_they_stand(browser: Browser) -> None:
    found = {}
    for things in (True, False):
        scene = Scene(6)
        if things:
            scene.posts, scene.walls = [[-1.0, 0.3, 0.15]], [[-1.5, -0.4, -0.5, -0.4]]
        with served(scene) as one, watched(browser, one.address, tolerated="Canvas2D") as page:
            one.feed(3)
            until(page, "formation.view.camera.placed && formation.model.frames >= 1")
            page.wait_for_timeout(200)
            found[things] = [page.evaluate(f"{PIXEL}({place})") for place in ([-1.0, 0.33], [-1.1, -0.4])]
    assert found[True][0] == found[True][1]
    assert not set(found[True]) & set(found[False])


def test_who_gets_out_of_the_way_says_so_in_its_row(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address) as page:
        one.play()
        one.scene.evades = {"robot3": EVADES["yields"], "robot4": EVADES["blocked"]}
        one.scene.aside.add("robot4")
        until(page, "document.querySelector('[data-robot=robot3] .reason').textContent !== ''")
        assert page.inner_text('[data-robot="robot3"] .reason') == "gets out of the way"
        assert page.inner_text('[data-robot="robot4"] .reason') == "does not follow"
        one.scene.aside.clear()
        until(page, "document.querySelector('[data-robot=robot4] .reason').textContent.startsWith('stopped')")
        assert page.inner_text('[data-robot="robot4"] .reason') == "stopped by its protective zone"
