"""`python -m tests.processes.page.screenshots FOLDER`: save the README's pictures of the page."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser

from tests.support.launched import started
from tests.support.served import browsing, until, watched


def save_pictures(browser: Browser, folder: Path) -> int:
    """Save two pictures of a real run; return how many messages the monitor has missed until then."""
    with (
        tempfile.TemporaryDirectory() as scratch,
        started("six_robots", "--control", "--page", "127.0.0.1:0", folder=Path(scratch)) as process,
    ):
        assert process.stderr is not None
        address = next(line for line in process.stderr if line.startswith("Page: ")).split()[1]
        desk: Any = {"viewport": {"width": 1280, "height": 760}, "color_scheme": "light"}
        phone: Any = {"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"}
        with (
            watched(browser, address, **desk) as one,
            watched(browser, address, device_scale_factor=1.5, **phone) as other,
        ):
            until(one, "formation.model.frame?.elapsed > 3.2")
            one.screenshot(path=folder / "page_six_robots.png")
            other.screenshot(path=folder / "page_phone.png")
            return int(other.evaluate("formation.model.frame.missed"))


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with browsing() as browser:
        print(f"page_six_robots.png, page_phone.png: {save_pictures(browser, folder)} messages missed")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
