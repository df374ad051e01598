"""Requests to the page's server, and stand-ins for the operator and the replay behind it."""

from __future__ import annotations

import json
import threading
from typing import Any

import httpx

from formation.monitor.web.server import PageServer
from tests.support.child import PATIENCE
from tests.support.looking import PLAIN

TOKEN = "a-token-for-a-test"  # noqa: S105 - it opens nothing
JSON = {"content-type": "application/json"}
BEARER = {**JSON, "authorization": f"Bearer {TOKEN}"}


class DriveRecorder:
    """Accepts and records every velocity; each answer has the next token."""

    def __init__(self) -> None:
        self.driven: list[tuple[float, float, int]] = []

    def drive(self, *, driver: str, forward: float, turn: float, token: int) -> dict[str, Any]:
        assert driver.startswith("page-")
        self.driven.append((forward, turn, token))
        first = token == 0
        return {
            "ok": not first,
            "reason": "",
            "code": "first" * first,
            "mode": "run",
            "token": len(self.driven),
        }


class OrderRecorder(DriveRecorder):
    """Accepts and records every order."""

    token = TOKEN

    def __init__(self, error: Exception | None = None) -> None:
        super().__init__()
        self.given: list[tuple[str, dict[str, Any], str, float | None]] = []
        self.error = error
        self.hold = threading.Event()
        self.hold.set()

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        self.given.append((do, what, click, seen))
        assert self.hold.wait(PATIENCE)
        if self.error is not None:
            raise self.error
        return {"do": do, "missing": []}


class Player:
    """Accepts and records every request to a replay."""

    def __init__(self) -> None:
        self.wishes: list[tuple[str, float | None]] = []

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        self.wishes.append((do, to))
        if to == 13.0:
            raise ValueError("13: there is no such moment")
        return {"paused": do == "pause"}


def requested(server: PageServer, path: str, body: Any = None, **headers: str) -> httpx.Response:
    content = body if isinstance(body, (bytes, type(None))) else json.dumps(body).encode()
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    method = "GET" if body is None else "POST"
    url = server.address + path
    return httpx.request(method, url, content=content, headers=names, timeout=PATIENCE, verify=PLAIN)
