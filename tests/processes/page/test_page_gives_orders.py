"""The page's controls: when they are shown, what they send, and how answers are shown."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, Route

from tests.processes.page.asking import DriveRecorder, Player
from tests.processes.page.scene import EPOCH, Scene
from tests.support.child import PATIENCE
from tests.support.served import PATIENT, Served, served, until, watched

pytestmark = pytest.mark.browser
TOKEN = "a-token-for-tests"  # noqa: S105 - it protects nothing
POST = "fetch('api/order', {method: 'POST', body: '{}'}).then((answer) => answer.status)"
ESCAPE = "document.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape'}))"
REFUSED = "status of 401"
"""Text in the browser's console about a refused request."""


class Fleet(DriveRecorder):
    """Records orders and velocities; the fourth robot does not answer, the fifth refuses."""

    token = TOKEN

    def __init__(self) -> None:
        super().__init__()
        self.requested: list[tuple[str, str | None]] = []
        self.legs: list[list[dict[str, Any]]] = []
        self.seen: list[float | None] = []
        self.clicks: set[str] = set()
        self.slow: dict[str, threading.Event] = {}
        """Event for which the answer to an order waits, by order."""
        self.zero = threading.Event()
        """Event for which the answer to a zero velocity waits."""
        self.zero.set()

    def drive(self, **how: Any) -> dict[str, Any]:
        answer = super().drive(**how)
        if self.driven[-1][:2] == (0.0, 0.0):
            assert self.zero.wait(PATIENCE)
        return answer

    def wait_for(self, what: Callable[[], bool], page: Page) -> None:
        """Wait until `what` holds."""
        deadline = time.monotonic() + PATIENCE
        while not what():
            assert time.monotonic() < deadline, self.driven[-5:]
            page.wait_for_timeout(20)

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Return a report as `formation order --json` prints it."""
        self.requested.append((do, what.get("shape")))
        self.legs += [what["legs"]] if what.get("legs") else []
        self.seen.append(seen)
        self.clicks.add(click)
        if do in self.slow:
            self.slow[do].wait(PATIENCE)
        answers = [
            {"robot": f"robot{number}", "mode": do, "reason": "", "ms": 1.0} for number in (1, 2, 3, 6)
        ]
        refused = [{"robot": "robot5", "mode": do, "reason": "not now", "ms": 1.0}]
        return {"do": do, "acknowledged": answers, "refused": refused, "missing": ["robot4"]}


@pytest.fixture
def fleet() -> Fleet:
    return Fleet()


@pytest.fixture
def controlled(fleet: Fleet) -> Iterator[Served]:
    with served(Scene(6, control=True), fleet) as one:
        one.play()
        yield one


@contextmanager
def opened_with_token(browser: Browser, one: Served, tolerated: str = "") -> Iterator[Page]:
    with watched(browser, f"{one.address}#token={TOKEN}", before=PATIENT, tolerated=tolerated) as page:
        page.wait_for_selector('[data-do="stop"]', state="visible")
        yield page


def test_page_without_control_has_no_buttons_and_no_shortcut(browser: Browser) -> None:
    with served(Scene(6)) as plain, watched(browser, plain.address, tolerated="status of 40") as page:
        plain.feed()
        until(page, "formation.model.frames > 0")
        assert not page.is_visible("#orders")
        posts = []
        page.on("request", lambda one: posts.append(one.url) if one.method == "POST" else None)
        for _ in range(2):
            page.keyboard.press("Escape")
        assert page.evaluate(POST) in {404, 405}
        assert posts == [f"{plain.address}api/order"]


def test_token_leaves_address_and_survives_reload(browser: Browser, controlled: Served) -> None:
    with opened_with_token(browser, controlled) as page:
        assert page.url == controlled.address
        page.reload()
        page.wait_for_selector('[data-do="stop"]', state="visible")


def test_stop_takes_one_click_and_lists_failures_first(
    browser: Browser, controlled: Served, fleet: Fleet
) -> None:
    with opened_with_token(browser, controlled) as page:
        until(page, "formation.model.frames > 0")
        page.click('[data-do="stop"]')
        result = page.locator("#acknowledgements li")
        result.nth(5).wait_for()
        assert fleet.requested == [("stop", None)]
        assert result.all_inner_texts()[:3] == [
            "✕ robot4 NO ANSWER", "✕ robot5 REFUSED: not now", "✓ robot1 stop 1 ms",
        ]  # fmt: skip
        assert page.inner_text("#order-result") == "stop: 4 of 6 obey"
        assert page.get_attribute("#order-result", "data-tone") == "bad"
        assert fleet.seen[0] == pytest.approx(EPOCH + controlled.scene.time, abs=30.0)


def test_double_escape_stops_and_single_does_not(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    with opened_with_token(browser, controlled) as page:
        page.keyboard.press("Escape")
        page.wait_for_timeout(1100)
        page.keyboard.press("Escape")
        assert fleet.requested == []
        page.evaluate(f"{ESCAPE}, {ESCAPE}")  # both at once, also on a busy machine
        page.locator("#acknowledgements li").first.wait_for()
        assert fleet.requested == [("stop", None)]


def test_late_answer_does_not_hide_result_of_stop(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    fleet.slow["hold"] = threading.Event()
    with opened_with_token(browser, controlled) as page:
        with page.expect_response(lambda one: "hold" in (one.request.post_data or "")):
            page.click('[data-do="hold"]')
            page.click('[data-do="stop"]')
            page.locator("#order-result", has_text="stop: 4 of 6").wait_for()
            fleet.slow["hold"].set()
        page.locator(
            "#acknowledgements li", has_text="hold: 4 of 6 obey"
        ).wait_for()  # below that of the stop
        assert page.inner_text("#order-result") == "stop: 4 of 6 obey"


def test_result_of_hold_is_shown_after_newer_order(
    browser: Browser, controlled: Served, fleet: Fleet
) -> None:
    fleet.slow["hold"] = threading.Event()
    fleet.slow["shape"] = threading.Event()
    with opened_with_token(browser, controlled) as page:
        page.click('[data-do="hold"]')
        for _ in range(2):  # it asks back
            page.click('[data-do="shape"]')
        page.locator("#order-result", has_text="shape: asking").wait_for()
        fleet.slow["hold"].set()
        page.locator("#order-result", has_text="hold: 4 of 6 obey").wait_for()
        fleet.slow["shape"].set()
        page.locator("#order-result", has_text="shape: 4 of 6 obey").wait_for()


def test_order_without_answer_does_not_hide_result_of_newer_order(
    browser: Browser, controlled: Served
) -> None:
    held: list[Route] = []

    def hold_up(route: Route) -> None:
        if "hold" in (route.request.post_data or ""):
            held.append(route)
        else:
            route.continue_()

    with opened_with_token(browser, controlled, tolerated="net::ERR") as page:
        page.route("**/api/order", hold_up)
        page.click('[data-do="hold"]')
        page.click('[data-do="stop"]')
        page.locator("#order-result", has_text="stop: 4 of 6").wait_for()
        with page.expect_event("requestfailed"):
            held[0].abort()
        page.wait_for_timeout(100)
        assert page.inner_text("#order-result") == "stop: 4 of 6 obey"


def test_run_release_and_shape_need_second_click(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    with opened_with_token(browser, controlled) as page:
        for do in ("run", "release", "shape"):
            before = len(fleet.requested)
            if do == "shape":
                page.select_option("#order-shape", "wedge")
            button = page.locator(f'[data-do="{do}"]')
            button.click()
            assert "press again" in button.inner_text()
            assert len(fleet.requested) == before
            button.click()
            page.locator("#order-result", has_text=f"{do}: 4 of 6").wait_for()
        assert fleet.requested == [("run", None), ("release", None), ("shape", "wedge")]
        assert len(fleet.clicks) == 3  # each confirmed order has its own click id
        page.click('[data-do="hold"]')
        page.locator("#order-result", has_text="hold: 4 of 6").wait_for()


def test_pending_confirmation_ends_with_other_button_or_timeout(
    browser: Browser, controlled: Served, fleet: Fleet
) -> None:
    with watched(browser, f"{controlled.address}#token={TOKEN}") as page:
        page.click('[data-do="run"]')
        page.click('[data-do="release"]')
        assert "press again" not in page.locator('[data-do="run"]').inner_text()
        asking = "document.querySelector('[data-do=\"release\"] .again').textContent"
        until(page, f"{asking} === ''")
        for do in ("run", "release"):
            page.click(f'[data-do="{do}"]')
        assert fleet.requested == []


def test_page_asks_again_after_wrong_token(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    with watched(browser, controlled.address, tolerated=REFUSED) as page:
        assert page.is_visible("#token-form")
        assert not page.is_visible('[data-do="stop"]')
        page.fill("#token", "guessed")
        page.keyboard.press("Enter")
        page.wait_for_selector("#token-wrong", state="visible")  # before any order is given
        assert not page.is_visible('[data-do="stop"]')
        page.fill("#token", TOKEN)
        page.keyboard.press("Enter")
        page.click('[data-do="stop"]')
        page.locator("#acknowledgements li").first.wait_for()
        assert fleet.requested == [("stop", None)]


def test_changed_token_is_noticed_at_order_and_at_opening(
    browser: Browser, controlled: Served, fleet: Fleet
) -> None:
    with watched(browser, f"{controlled.address}#token={TOKEN}", tolerated=REFUSED) as page:
        page.wait_for_selector('[data-do="stop"]', state="visible")
        fleet.token = "of-another-start"  # noqa: S105 - as above
        page.click('[data-do="stop"]')
        page.wait_for_selector("#token-wrong", state="visible")
        assert "REFUSED" in page.inner_text("#order-result")
        assert fleet.requested == []
    with watched(browser, f"{controlled.address}#token={TOKEN}", tolerated=REFUSED) as page:
        page.wait_for_selector("#token-wrong", state="visible")
        assert not page.is_visible('[data-do="stop"]')


def test_order_to_closed_server_is_shown_as_not_sent(browser: Browser, controlled: Served) -> None:
    with watched(browser, f"{controlled.address}#token={TOKEN}", tolerated="net::ERR") as page:
        controlled.close()
        page.click('[data-do="stop"]')
        page.locator("#order-result", has_text="NOT SENT").wait_for()
        assert "emergency stop" in page.inner_text("#order-result")


def test_replay_controls_send_pause_speed_and_seek(browser: Browser) -> None:
    player = Player()
    with served(Scene(6, live=False), steer=player.steer) as one, watched(browser, one.address) as page:
        one.feed(20)
        page.locator("#replay-time", has_text="0:02 of 0:30").wait_for()
        one.play()
        page.locator("#connection", has_text="replay").wait_for()
        page.click("#replay-play")
        page.select_option("#replay-speed", "5")
        page.locator("#replay-at").fill("12.5")
        deadline = time.monotonic() + PATIENCE
        while len(player.wishes) < 3 and time.monotonic() < deadline:
            page.wait_for_timeout(20)
        assert sorted(player.wishes) == [("pause", None), ("seek", EPOCH + 12.5), ("speed", 5.0)]


def test_pad_drives_while_pressed_by_first_button(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    with opened_with_token(browser, controlled) as page:
        page.click("#drive-open")
        box = page.locator("#drive-pad").bounding_box()
        assert box is not None
        middle, top = box["x"] + 0.5 * box["width"], box["y"] + 1.0
        page.mouse.move(middle, top)
        page.mouse.down(button="right")
        page.mouse.move(middle, top + 1.0)
        page.mouse.up(button="right")
        page.keyboard.down("Meta")
        page.keyboard.press("ArrowUp")
        page.keyboard.up("Meta")
        page.wait_for_timeout(200)
        assert fleet.driven == []

        page.mouse.move(middle, box["y"] + 0.5 * box["height"])
        page.mouse.down()
        page.mouse.move(middle, top)
        page.locator("#drive-state", has_text="driving").wait_for()
        page.mouse.up()
        page.locator("#drive-state", has_text="let go").wait_for()
        assert max(forward for forward, _, _ in fleet.driven) > 0.9
        assert fleet.driven[-1][:2] == (0.0, 0.0)
        assert [token for _, _, token in fleet.driven] == list(range(len(fleet.driven)))

        page.mouse.down()
        page.locator("#drive-state", has_text="driving").wait_for()
        fleet.zero.clear()
        page.mouse.up()
        fleet.wait_for(lambda: fleet.driven[-1][:2] == (0.0, 0.0), page)
        page.mouse.down()  # before the zero is answered
        fleet.zero.set()
        stood = len(fleet.driven)
        fleet.wait_for(lambda: len(fleet.driven) > stood, page)
        assert fleet.driven[-1][0] > 0.9
        page.mouse.up()
        page.locator("#drive-state", has_text="let go").wait_for()


def test_arrow_keys_drive_while_pad_has_focus(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    with opened_with_token(browser, controlled) as page:
        page.click("#drive-open")
        page.keyboard.down("ArrowUp")
        page.keyboard.down("ArrowLeft")
        page.locator("#drive-state", has_text="driving").wait_for()
        fleet.wait_for(lambda: (1.0, 1.0) in {one[:2] for one in fleet.driven}, page)
        page.evaluate("document.querySelector('#drive-pad').blur()")
        page.locator("#drive-state", has_text="let go").wait_for()
    assert (1.0, 1.0) in {one[:2] for one in fleet.driven}
    assert fleet.driven[-1][:2] == (0.0, 0.0)


def test_points_clicked_on_map_become_route(browser: Browser, controlled: Served, fleet: Fleet) -> None:
    with opened_with_token(browser, controlled) as page:
        until(page, "formation.view.camera.placed")
        page.click("#follow")  # so that the map does not move between the clicks
        page.click("#route-open")
        expected = []
        for share in (0.3, 0.6):  # the bar of the route may have made the map lower
            until(page, "formation.view.camera.height === document.querySelector('#map').clientHeight")
            box = page.locator("#map").bounding_box()
            assert box is not None
            x, y = share * box["width"], 0.6 * box["height"]
            expected.append(page.evaluate(f"formation.view.camera.place({x}, {y})"))
            page.mouse.click(box["x"] + x, box["y"] + y)
        page.locator("#route-go", has_text="Go along 2 points").click()
        page.locator("#order-result", has_text="route: 4 of 6 obey").wait_for()
    ((leg,),) = fleet.legs
    (left, right) = leg["waypoints"]
    assert left[0] < right[0]
    assert [*left, *right] == pytest.approx([*expected[0], *expected[1]], abs=0.05)
    assert leg["speed"] > 0.0
