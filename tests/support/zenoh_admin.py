"""Looks into running processes through the admin space: their subscriptions and links.

The admin space of a session with the identifier ZID, of the kind KIND (peer, router or client), answers

- ``@/ZID/KIND``: JSON with ``metadata.name`` and, in ``sessions``, one entry for each session linked with it
  (``peer``: its identifier, ``whatami``, ``links``: pairs of ``src`` and ``dst``);
- ``@/ZID/KIND/subscriber/KEY`` (and ``queryable``, ``publisher``): JSON whose ``clients`` holds ZID if the
  session itself declared KEY; what it only knows of others has theirs. KEY comes with the team's prefix.

A session with a namespace sees no admin space but its own, so this one has none. A peer shows nothing but
itself; a router shows its clients as well. Sessions that look are left out of what is seen, those of earlier
looks too: a process may show one for a moment after it has closed.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import zenoh

from formation.transport.bus_config import DEFAULTS
from tests.support.child import PATIENCE

_LOOKING: set[str] = set()
"""Identifiers of all sessions of this process that look, or looked, at others."""


@dataclass(frozen=True)
class Peer:
    """One session of a running process, seen from outside."""

    zid: str
    name: str
    subscriptions: frozenset[str]
    """Keys it subscribes to itself."""
    queryables: frozenset[str]
    """Keys it answers itself."""
    publications: frozenset[str]
    """Keys it publishes itself."""
    links: dict[str, int]
    """Identifier of each session linked with it but those that look, and the number of links with it."""
    kinds: frozenset[str]
    """What those sessions are: peer, client or router."""
    locators: tuple[str, ...]
    """Where it accepts links."""


def inspect(endpoint: str, timeout: float = PATIENCE) -> Peer:
    """The session that listens on `endpoint`. Raises TimeoutError if there is none."""
    with _looking_at(endpoint, timeout) as (session, zid, kind):
        return _peer(session, zid, kind, timeout)


def clients(endpoint: str, timeout: float = PATIENCE) -> list[Peer]:
    """The clients of the router that listens on `endpoint`. Raises TimeoutError if there is none."""
    with _looking_at(endpoint, timeout) as (session, zid, kind):
        root = f"@/{zid}/{kind}"
        linked = _about(session, root, timeout)["sessions"]
        return [
            _peer(session, other["peer"], "client", timeout)
            for other in linked
            if other["whatami"] == "client"  # those that look are peers
        ]


@contextmanager
def _looking_at(endpoint: str, timeout: float) -> Iterator[tuple[zenoh.Session, str, str]]:
    """A session linked with the one that listens on `endpoint`, and that one's identifier and kind."""
    config = zenoh.Config()
    for path, value in DEFAULTS:
        config.insert_json5(path, value)
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        _LOOKING.add(str(session.info.zid()))
        deadline = time.monotonic() + timeout
        while True:
            for kind, zids in (("peer", session.info.peers_zid()), ("router", session.info.routers_zid())):
                if zids:
                    yield session, str(zids[0]), kind
                    return
            if time.monotonic() > deadline:
                raise TimeoutError(f"no process listens on {endpoint}")
            time.sleep(0.005)


def _peer(session: zenoh.Session, zid: str, kind: str, timeout: float) -> Peer:
    root = f"@/{zid}/{kind}"
    about = _about(session, root, timeout)
    others = [s for s in about["sessions"] if s["peer"] not in _LOOKING]
    return Peer(
        zid=zid,
        name=(about["metadata"] or {}).get("name", ""),
        subscriptions=_own(session, f"{root}/subscriber/", zid, timeout),
        queryables=_own(session, f"{root}/queryable/", zid, timeout),
        publications=_own(session, f"{root}/publisher/", zid, timeout),
        links={s["peer"]: len(s["links"]) for s in others},
        kinds=frozenset(s["whatami"] for s in others),
        locators=tuple(about["locators"]),
    )


def _about(session: zenoh.Session, root: str, timeout: float) -> Any:
    """What a session says of itself. A link is there a moment before its answering process is known."""
    deadline = time.monotonic() + timeout
    while not (answers := _ask(session, root, timeout)):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{root} does not answer")
        time.sleep(0.005)
    return answers[root]


def _own(session: zenoh.Session, prefix: str, zid: str, timeout: float) -> frozenset[str]:
    entries = _ask(session, prefix + "**", timeout).items()
    return frozenset(key.removeprefix(prefix) for key, entry in entries if zid in entry["clients"])


def _ask(session: zenoh.Session, selector: str, timeout: float) -> dict[str, Any]:
    replies = session.get(selector, target=zenoh.QueryTarget.ALL, timeout=timeout)
    answers = [reply.ok for reply in replies if reply.ok is not None]
    return {str(answer.key_expr): json.loads(answer.payload.to_bytes()) for answer in answers}
