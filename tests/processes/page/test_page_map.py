"""The map shows posts and walls, is moved by mouse, finger and keyboard, and else follows the formation."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page

from tests.processes.page.scene import Scene
from tests.support.child import PATIENCE
from tests.support.served import Served, drawn, served, until, watched

pytestmark = pytest.mark.browser
ROW = '[data-robot="{}"]'
PIXELS = """((places) => {
  const {camera, canvas, pen, requested} = formation.view, dots = canvas.width / canvas.clientWidth;
  const pixel = ([x, y]) => [...pen.getImageData(dots * camera.sx(x), dots * camera.sy(y), 1, 1).data].join();
  return camera.placed && !requested && places.map(pixel);
})"""
"""Returns the pixels at some places once all is drawn: setting the size of a canvas empties it."""


@pytest.fixture(scope="module")
def still() -> Iterator[Served]:
    """A page of six robots, without new frames."""
    with served(Scene(6)) as one:
        one.feed(3)
        yield one


def test_tap_selects_robot_and_drag_ends_following(browser: Browser, still: Served) -> None:
    with watched(browser, still.address) as page:
        _wait_until_laid_out(page)
        x, y = page.evaluate(
            "((c, r) => [c.sx(r.place.x), c.sy(r.place.y)])(formation.view.camera, formation.model.robots[1])"
        )
        page.locator("#map").click(position={"x": x, "y": y})
        chosen = page.locator(ROW.format("robot2")).locator(".robot-name")
        assert chosen.get_attribute("aria-pressed") == "true"
        assert page.get_attribute("#follow", "aria-pressed") == "true"
        box = page.locator("#map").bounding_box()
        assert box is not None
        page.mouse.move(box["x"] + 100, box["y"] + 200)
        page.mouse.down()
        page.mouse.move(box["x"] + 180, box["y"] + 220, steps=4)
        page.mouse.up()
        assert page.get_attribute("#follow", "aria-pressed") == "false"
        page.click("#follow")
        assert page.get_attribute("#follow", "aria-pressed") == "true"


def test_keys_move_map_and_restore_following(browser: Browser, still: Served) -> None:
    where = "[formation.view.camera.x, formation.view.camera.y, formation.view.camera.scale]"
    with watched(browser, still.address) as page:
        _wait_until_laid_out(page)
        page.focus("#map")
        start = page.evaluate(where)
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("+")
        moved = page.evaluate(where)
        assert moved[0] < start[0]
        assert moved[2] > start[2]
        assert page.get_attribute("#follow", "aria-pressed") == "false"
        page.keyboard.press("0")
        assert page.get_attribute("#follow", "aria-pressed") == "true"
        until(page, f"Math.abs(formation.view.camera.scale - {start[2]}) < 1e-6")


def test_two_fingers_zoom_map_and_one_moves_it(browser: Browser, still: Served) -> None:
    scale, where = "formation.view.camera.scale", "formation.view.camera.x"
    with watched(browser, still.address, viewport={"width": 390, "height": 844}, has_touch=True) as page:
        _wait_until_laid_out(page)
        box = page.locator("#map").bounding_box()
        assert box is not None
        hand = page.context.new_cdp_session(page)
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

        def touch(kind: str, *fingers: float) -> None:
            points = [{"x": x + finger, "y": y, "id": number} for number, finger in enumerate(fingers)]
            hand.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        before = page.evaluate(scale)
        touch("touchStart", -40.0, 40.0)
        touch("touchMove", -60.0, 60.0)
        touch("touchMove", -80.0, 80.0)
        touch("touchEnd")
        until(page, f"{scale} > {1.3 * before}")  # a browser may report touches late
        left = page.evaluate(where)
        touch("touchStart", 0.0)
        touch("touchMove", 50.0)
        touch("touchEnd")
        until(page, f"{where} < {left}")
        assert page.get_attribute("#follow", "aria-pressed") == "false"


def test_reduced_motion_centres_map_without_animation(browser: Browser) -> None:
    with served(Scene(6)) as one, watched(browser, one.address, reduced_motion="reduce") as page:
        one.feed(2)
        until(page, "formation.view.camera.placed")
        one.feed()
        until(page, "formation.model.frames >= 2")
        _wait_until_centred(page)


def _wait_until_laid_out(page: Page) -> None:
    """Wait until ten pictures show the map alike: what the first frame writes above it changes its height."""
    seen: list[object] = []
    deadline = time.monotonic() + PATIENCE
    while len(seen) < 10 or any(one != seen[-1] for one in seen[-10:]):
        assert time.monotonic() < deadline, f"the map still moves: {seen[-1:]}"
        drawn(page)
        camera = page.evaluate("((c) => c.placed && [c.x, c.y, c.scale, c.height])(formation.view.camera)")
        seen = [*seen, camera] if camera else []


def _wait_until_centred(page: Page) -> None:
    """Wait until the centre of the camera is that of the formation."""
    until(
        page,
        "((c, r) => Math.abs(c.x - (Math.min(...r) + Math.max(...r)) / 2) < 1e-6)(formation.view.camera,"
        " formation.model.robots.flatMap((one) => [one.place.x, one.slot.x]))",
    )


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
