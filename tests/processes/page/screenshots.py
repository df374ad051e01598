"""`python -m tests.processes.page.screenshots FOLDER`: the page as people see it, to be looked at.

Six and a hundred robots, on a desk, a phone and a wall, light and dark; with orders, as a replay, and when
nothing comes any more.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any, Literal, NamedTuple

from playwright.sync_api import Browser, Page

from tests.processes.page.scene import Scene, event
from tests.support.launched import started
from tests.support.served import Served, browsing, served, until, watched

Theme = Literal["light", "dark"]
DESK, PHONE, WALL = (1280, 800), (390, 844), (1920, 1080)


class Shot(NamedTuple):
    """One picture."""

    name: str
    robots: int
    size: tuple[int, int]
    theme: Theme
    tab: str = "map"
    control: bool = False
    live: bool = True
    moment: int = 30
    """Frames into the scene."""
    stale: bool = False


THEMES: tuple[Theme, ...] = ("light", "dark")
SHOTS = (
    *(
        Shot(f"{count}_{place}_{theme}", count, size, theme)
        for count in (6, 100)
        for place, size in (("desk", DESK), ("phone", PHONE))
        for theme in THEMES
    ),
    *(
        Shot(f"{count}_phone_{tab}_{theme}", count, PHONE, theme, tab=tab)
        for count, theme in zip((6, 100), THEMES, strict=True)
        for tab in ("robots", "events")
    ),
    Shot("6_desk_control", 6, DESK, "light", control=True, moment=200),
    Shot("6_phone_control", 6, PHONE, "dark", control=True, moment=200),
    Shot("6_desk_stale", 6, DESK, "light", stale=True),
    Shot("6_phone_stale", 6, PHONE, "dark", stale=True),
    Shot("6_desk_replay", 6, DESK, "dark", live=False),
    Shot("6_wall", 6, WALL, "dark", moment=90),
    Shot("100_wall", 100, WALL, "light", moment=90),
)


class Obedient:
    """Everybody but the fourth robot obeys."""

    token = "secret"  # noqa: S105 - nobody is kept out by it

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """What `formation order --json` says."""
        del what, click, seen
        answers = [
            {"robot": name, "mode": do, "reason": "", "ms": 2.0 + 1.7 * number}
            for number, name in enumerate(self._scene.names)
            if name != "robot4"
        ]
        for one in answers:
            self._scene.state[str(one["robot"])] = ("stop", "stopped by the operator")
        return {"do": do, "acknowledged": answers, "refused": [], "missing": ["robot4"]}


class Still:
    """A replay that does what it is told."""

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        """It stands."""
        return {"do": do, "to": to}


def take_screenshot(browser: Browser, shot: Shot, folder: Path) -> Path:
    """Make one picture; where it is."""
    scene = Scene(shot.robots, live=shot.live, control=shot.control)
    control = Obedient(scene) if shot.control else None
    with served(scene, control, None if shot.live else Still()) as page_server:
        if not shot.live:
            page_server.source.tell(recording="recordings/scene.mcap")
        context = browser.new_context(
            viewport={"width": shot.size[0], "height": shot.size[1]},
            color_scheme=shot.theme,
            device_scale_factor=_dots(shot),
        )
        page = context.new_page()
        page.goto(page_server.address + ("#token=secret" if shot.control else ""))
        until(page, "formation.model.hello !== null")
        _act(page_server, page, shot)
        if shot.tab != "map":
            page.click(f'[data-shows="{shot.tab}"]')
        path = folder / f"{shot.name}.png"
        page.screenshot(path=path)
        context.close()
    return path


def _dots(shot: Shot) -> float:
    return 2.0 if shot.size is PHONE else 1.0


def _act(page_server: Served, page: Page, shot: Shot) -> None:
    """What has happened before the picture is made."""
    scene = page_server.scene
    for number, name in enumerate(scene.names):
        page_server.note(event(number, 0.02 * number, "joined", name, "joined"))
    number = len(scene.names)
    for frame in range(shot.moment):
        if frame == shot.moment - 18:
            lost = scene.names[-2]
            scene.silent[lost] = scene.time
        if frame == shot.moment - 12:
            scene.state[scene.names[2]] = ("hold", "no neighbour is fresh: robot1 0.31 s, robot2 0.25 s")
            page_server.note(event(number, scene.time, "held", scene.names[2], "no neighbour is fresh", 30))
        if frame == shot.moment - 8:
            page_server.note(
                event(number + 1, scene.time, "lost", scene.names[-2], "no position for 1.0 s", 40)
            )
        page_server.feed()
        page.wait_for_timeout(12)
    if shot.control:
        page.click('[data-do="stop"]')
        page.wait_for_selector("#acknowledgements li")
        page_server.feed(5)
    if not shot.stale:
        page_server.play(0.2)
    page.wait_for_timeout(2600 if shot.stale else 700)


def of_a_run(browser: Browser, folder: Path) -> int:
    """Two pictures of a real run, for the README; how many messages a busy machine has missed until then."""
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
    """Make all pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    with browsing() as browser:
        print(f"page_six_robots.png, page_phone.png: {of_a_run(browser, folder)} messages missed")
        for shot in SHOTS:
            print(take_screenshot(browser, shot, folder))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
