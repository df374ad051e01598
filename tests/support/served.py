"""The page as it is served, and a browser to look at it; a scene instead of a fleet."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

from playwright.sync_api import Browser, ConsoleMessage, Page, sync_playwright

from formation.monitor.metrics.snapshot import Snapshot
from formation.monitor.web.address import Bind
from formation.monitor.web.routes import Control, Steer
from formation.monitor.web.server import PageServer
from formation.monitor.web.source import Source
from tests.processes.page.scene import Scene
from tests.support.child import PATIENCE
from tests.support.needs import path_of

NO_SNAPSHOT = cast("Snapshot", None)
"""A scene has none: no test asks for metrics by name."""
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-extensions",
    "--disable-sync",
    "--no-first-run",
)
PATIENT = """const soon = globalThis.setTimeout;
globalThis.setTimeout = (act, time, ...rest) => soon(act, time < 1000 ? time : 100 * time, ...rest);
AbortSignal.timeout = () => new AbortController().signal;"""
"""Run `before` a page, it gives a busy machine time: to answer, and to press a button a second time."""


@contextmanager
def browsing() -> Iterator[Browser]:
    """This machine's own Chromium, without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path_of("chromium"), args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def watched(
    browser: Browser, address: str, *, tolerated: str | Sequence[str] = "", before: str = "", **context: Any
) -> Iterator[Page]:
    """`address` in a window of its own, in which nothing may go wrong but texts that are `tolerated`.

    `before` is run there before anything of the page is.
    """
    wrong: list[str] = []

    def result(message: ConsoleMessage) -> None:
        if message.type in {"error", "warning"}:
            wrong.append(message.text)

    own = browser.new_context(**context)
    if before:
        own.add_init_script(before)
    page = own.new_page()
    page.set_default_timeout(1000.0 * PATIENCE)
    page.on("console", result)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    try:
        page.goto(address)
        until(page, "globalThis.formation?.model.hello")
        yield page
    finally:
        own.close()
    tolerable = (tolerated,) if isinstance(tolerated, str) else tolerated
    intolerable = [text for text in wrong if not any(one and one in text for one in tolerable)]
    assert not intolerable, intolerable


def drawn(page: Page) -> None:
    """Wait until the page has drawn the frames that have come."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => done()))")


def until(page: Page, expression: str, patience: float = PATIENCE) -> Any:
    """What `expression` gives once that is true.

    Asked from outside again and again: `page.wait_for_function` would have the page evaluate text, which the
    page's own policy forbids.
    """
    deadline = time.monotonic() + patience
    while not (value := page.evaluate(expression)):
        assert time.monotonic() < deadline, f"not so within {patience:g} s: {expression}"
        page.wait_for_timeout(20)
    return value


class Served:
    """A page of one scene. `play` has it go on by itself, `feed` by hand."""

    def __init__(
        self, scene: Scene, control: Control | None = None, steer: Steer | None = None, port: int = 0
    ) -> None:
        self.scene = scene
        self.source = Source(scene.hello(), lambda: scene.now)
        self._server = PageServer(Bind(port=port), self.source, control, steer)
        self.address = self._server.address
        self._server.start()
        self._over = threading.Event()
        self._player: threading.Thread | None = None

    def feed(self, frames: int = 1) -> None:
        """So many frames more, as fast as they are made."""
        for _ in range(frames):
            frame = self.scene.step()
            if round(10 * self.scene.time) % 5 == 0:
                self.source.observe(frame["t"], frame["error"])
            self.source.show(frame, NO_SNAPSHOT)

    def note(self, event: dict[str, Any]) -> None:
        """Something happens."""
        self.source.note(event)

    def play(self, pause: float = 0.1) -> None:
        """A frame every `pause` seconds, from now on."""
        self._over.clear()

        def run() -> None:
            while not self._over.wait(pause):
                self.feed()

        self._player = threading.Thread(target=run, daemon=True)
        self._player.start()

    def hush(self) -> None:
        """No more frames, though the server lives."""
        self._over.set()
        if self._player is not None:
            self._player.join()

    def close(self) -> None:
        """End all."""
        self.hush()
        self._server.stop()


@contextmanager
def served(
    scene: Scene, control: Control | None = None, steer: Steer | None = None, port: int = 0
) -> Iterator[Served]:
    """A page that is closed at the end."""
    one = Served(scene, control, steer, port)
    try:
        yield one
    finally:
        one.close()
