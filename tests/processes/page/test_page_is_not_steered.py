"""The live page shows hostile names and texts of robots as text, and runs none of them."""

from __future__ import annotations

from typing import Any

import pytest
from playwright.sync_api import Browser

from formation.monitor.web.frames import FIELDS
from tests.processes.page.scene import Scene
from tests.support.served import served, until, watched

pytestmark = pytest.mark.browser
HOSTILE = "<img src=x onerror='globalThis.steered=1'><script>globalThis.steered=1</script>"
NAMES = (
    HOSTILE,
    "__proto__",
    "constructor",
    '"><svg onload=globalThis.steered=1>',
    f"</td>{HOSTILE}",
    "a" * 5000,
)


class Hostile(Scene):
    """A scene in which every text contains markup that would run a script."""

    def hello(self) -> dict[str, Any]:
        hello = super().hello()
        for robot, name in zip(hello["robots"], NAMES, strict=True):
            robot["name"] = name
        shapes: dict[str, list[float]] = {HOSTILE: [], "__proto__": [], "constructor": []}
        return {**hello, "mission": HOSTILE, "law": HOSTILE, "version": HOSTILE, "shapes": shapes}

    def frame(self) -> dict[str, Any]:
        frame = super().frame()
        for row in frame["r"]:
            for field in ("state", "reason", "health_why"):
                row[FIELDS.index(field)] = HOSTILE
        return {
            **frame,
            "shape": HOSTILE,
            "recording": {**frame["recording"], "path": HOSTILE, "failure": HOSTILE},
        }


def test_page_shows_hostile_text_and_never_runs_it(browser: Browser) -> None:
    with served(Hostile(6, control=True)) as one:
        for number, level in enumerate((20, 30, 40, 99)):
            result = {"robot": HOSTILE, "kind": HOSTILE, "text": HOSTILE}
            one.note({"n": number + 1, "at": 1.8e9, "level": level, **result})
        one.play()
        with watched(browser, one.address) as page:
            until(page, "formation.model.frames > 5")
            assert HOSTILE in page.inner_text("body")
            assert page.evaluate("globalThis.steered") is None
            assert page.evaluate("document.querySelectorAll('img, script:not([src])').length") == 0
