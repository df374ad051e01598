"""Looks into a running process through the admin space: what it subscribes to, whom it is linked with.

The admin space of a session with the identifier ZID answers

- ``@/ZID/peer``: JSON with ``metadata.name`` and, in ``sessions``, one entry for each session linked with it
  (``peer``: its identifier, ``whatami``, ``links``: pairs of ``src`` and ``dst``);
- ``@/ZID/peer/subscriber/KEY`` (and ``queryable``): JSON whose ``clients`` holds ZID if the session itself
  declared KEY; what it only knows of others has them under ``peers``. KEY comes with the team's prefix.

A session with a namespace sees no admin space but its own, so this one has none.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any

import zenoh

from formation.bus_config import DEFAULTS


@dataclass(frozen=True)
class Peer:
    """One running process, seen from outside."""

    zid: str
    name: str
    subscriptions: frozenset[str]
    """Keys it subscribes to itself."""
    queryables: frozenset[str]
    """Keys it answers itself."""
    links: dict[str, int]
    """Identifier of each session linked with it, ours left out, and the number of links with it."""
    kinds: frozenset[str]
    """What those sessions are: peer, client or router."""


def inspect(endpoint: str, timeout: float = 5.0) -> Peer:
    """The process that listens on `endpoint`. Raises TimeoutError if there is none."""
    config = zenoh.Config()
    for path, value in DEFAULTS:
        config.insert_json5(path, value)
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    with zenoh.open(config) as session:
        deadline = time.monotonic() + timeout
        while not (zids := session.info.peers_zid()):
            if time.monotonic() > deadline:
                raise TimeoutError(f"nobody listens on {endpoint}")
            time.sleep(0.005)
        (zid,) = map(str, zids)
        ours = str(session.info.zid())
        root = f"@/{zid}/peer"
        about = _ask(session, root, timeout)[root]
        others = [s for s in about["sessions"] if s["peer"] != ours]
        return Peer(
            zid=zid,
            name=(about["metadata"] or {}).get("name", ""),
            subscriptions=_own(session, f"{root}/subscriber/", zid, timeout),
            queryables=_own(session, f"{root}/queryable/", zid, timeout),
            links={s["peer"]: len(s["links"]) for s in others},
            kinds=frozenset(s["whatami"] for s in others),
        )


def _own(session: zenoh.Session, prefix: str, zid: str, timeout: float) -> frozenset[str]:
    entries = _ask(session, prefix + "**", timeout).items()
    return frozenset(key.removeprefix(prefix) for key, entry in entries if zid in entry["clients"])


def _ask(session: zenoh.Session, selector: str, timeout: float) -> dict[str, Any]:
    replies = session.get(selector, target=zenoh.QueryTarget.ALL, timeout=timeout)
    answers = [reply.ok for reply in replies if reply.ok is not None]
    return {str(answer.key_expr): json.loads(answer.payload.to_bytes()) for answer in answers}
