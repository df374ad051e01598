"""Check requests to the page: reject everything that a foreign web page makes a browser send.

A name that an attacker resolves to our address ("DNS rebinding") is not one of ours, so its requests are
refused by their Host; a request from another page has another Origin. Answers tell browsers to load and run
only what we serve ourselves.
"""

from __future__ import annotations

import asyncio
import ipaddress
from collections.abc import Collection
from contextlib import suppress
from urllib.parse import urlsplit

from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

POLICY = (
    b"default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none';"
    b" frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)
MAX_PATH_BYTES = 1024
"""Longest path of a request [bytes]."""


def host_is_ours(host: str, names: Collection[str]) -> bool:
    """Return whether a Host header names us: an address, which cannot be rebound, or one of our names."""
    name = _host_name(host)
    if name is None:
        return False
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return name.lower().rstrip(".") in names
    return True


def origin_is_ours(origin: str | None, host: str) -> bool:
    """Return whether a request is from our own page, or from no page: browsers name the origin of a POST."""
    return origin is None or origin.lower() == f"http://{host}".lower()


def names_of(hostname: str, bound: str) -> frozenset[str]:
    """Return every valid name of a machine called `hostname`, bound to `bound`."""
    own = hostname.lower().rstrip(".")
    short = own.partition(".")[0]
    return frozenset({"localhost", own, short, f"{short}.local", bound.lower()} - {""})


class Guard:
    """An application that refuses requests of other pages before `app` gets them."""

    def __init__(self, app: ASGIApp, names: Collection[str]) -> None:
        """`names` are ours, in lower case."""
        self._app, self._names = app, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or let it through."""
        if scope["type"] != "http":
            return

        async def answer(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", ()), *HEADERS]
            await send(message)

        app: ASGIApp = self._app
        if (refusal := self._refusal(scope)) is not None:
            status, text = refusal
            app = PlainTextResponse(f"{text}\n", status, {"cache-control": "no-store"})
        with suppress(asyncio.CancelledError):  # a request under way when the server ends is no error
            await app(scope, receive, answer)

    def _refusal(self, scope: Scope) -> tuple[int, str] | None:
        headers: dict[bytes, bytes] = dict(scope["headers"])
        host = headers.get(b"host", b"").decode("latin-1")
        if len(scope["raw_path"]) + len(scope["query_string"]) > MAX_PATH_BYTES:
            return 414, "the address is too long"
        if not host_is_ours(host, self._names):
            return 421, f"this is not {host[:80]!r}: ask by address, or by the name of this machine"
        origin = headers.get(b"origin")
        own = origin_is_ours(None if origin is None else origin.decode("latin-1"), host)
        if scope["method"] not in {"GET", "HEAD"} and not own:
            return 403, "only the page itself may ask for this"
        return None


def _host_name(host: str) -> str | None:
    """Return the name or address of a Host header, without its port; None if invalid."""
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port  # raises for an invalid port
    except ValueError:
        return None
    return parts.hostname if parts.netloc == host and "@" not in host else None
