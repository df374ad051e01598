"""What Zenoh refuses, counted by kind: words that access control forbids, and links that prove nothing.

Zenoh tells of refusals nowhere but in its log, which goes to file descriptor 1. So a pipe is put there, and
what the process itself says on stdout goes on to where it went. Zenoh's end of the pipe never blocks: what
does not fit is lost, and with it a count, but neither a message nor time. What is no refusal and at least a
warning is logged as our own.

Of access control the log has two lines for a refused message, from one thread and directly after each other::

    … ThreadId(02) …: ZID on …+CertCommonName(robot2)+… is unauthorized to Put (ingress) on KEY
    … ThreadId(02) …: Msg intercepted!

The first alone only says that Zenoh remembers what it would decide. Later messages on a declared key have
``Using cached result: ZID is unauthorized to …`` instead, without the name. Refused egress is no attack: it
is how this process keeps from others what is not for them.
"""

from __future__ import annotations

import atexit
import fcntl
import io
import logging
import os
import re
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Self

FILTER = (
    "zenoh::net::routing::interceptor=trace,zenoh::net::runtime::orchestrator=debug,"
    "zenoh_link_tls=warn,zenoh_link_commons=warn,zenoh_transport=warn"
)
"""``RUST_LOG`` that makes Zenoh tell of what it refuses."""
KINDS = 64
"""So many kinds are told apart, further ones are `OTHER`: who is refused chooses the keys."""
OTHER = "other"
LONGEST = 100
"""Characters of a kind."""
PIPE = 1 << 20
"""Bytes of log that may wait; less where the system gives less."""
PERIOD = 0.1
"""How often the log is read [s]."""
WARNINGS, WINDOW = 20, 10.0
"""Of Zenoh's other warnings so many are passed on in so many seconds; the rest is only counted."""

_INTERCEPTED = b"Msg intercepted!"
_THREAD = re.compile(rb"ThreadId\((\d+)\)")
_COLOUR = re.compile(rb"\x1b\[[0-9;]*m")
_DECISION = re.compile(
    r"(?P<zid>[0-9a-f]{1,32}) (?:on (?P<subject>\S+) )?is unauthorized to (?P<what>[A-Za-z/ ]+)"
    r" \((?P<flow>ingress|egress)\) on (?P<key>.*)"
)
_NAME = re.compile(r"CertCommonName\(([^)]*)\)")
_LEVEL = re.compile(rb"^\S+ +(WARN|ERROR) ")
_TARGET = re.compile(r"^\S+ +\S+ .*?ThreadId\(\d+\) (?P<target>[\w:]+): (?P<text>.*)")
_LINKS = (
    ("certificate expired", "certificate: expired"),
    ("certificate chain expired", "certificate: expired during the link"),
    ("certificate not valid yet", "certificate: not valid yet"),
    ("certificate not valid for name", "certificate: of another place"),
    ("UnknownIssuer", "certificate: unknown issuer"),
    ("BadSignature", "certificate: bad signature"),
    ("peer sent no certificates", "certificate: none"),
    ("invalid peer certificate", "certificate: invalid"),
    ("received corrupt message", "not TLS"),
    ("received fatal alert", "certificate: ours, which the other side does not take"),
    ("handshake eof", "handshake broken off"),
    ("handshake", "handshake failed"),
)
"""What Zenoh says of a link that it did not take, and what we call it; the first that fits."""
_LINK_MODULES = ("zenoh_link_tls", "zenoh_link_commons::tls")
_NOBODY_THERE = re.compile(rb"runtime::orchestrator: Unable to connect to (any of|tcp/|tls/|quic/|udp/)")
"""Twice a second for as long as a router is missing, which whoever dials it says himself, once."""
_DIALLED = re.compile(r"Unable to connect to configured peer (?P<endpoint>\S+)! .*?invalid peer certificate")
_STRANGER = b"did not match any configured ACL subject"
_log = logging.getLogger(__name__)


class Parser:
    """Reads Zenoh's log as it comes, in pieces cut anywhere."""

    def __init__(self, namespace: str = "") -> None:
        """`namespace` is the team's, which keys are told without."""
        self.counts: Counter[str] = Counter()
        """Refusals by kind, such as ``put robot3/position by robot2``."""
        self._prefix = f"{namespace}/" if namespace else ""
        self._rest = b""
        self._said: dict[bytes, str] = {}  # by thread: what it is about to refuse, if it does
        self._names: dict[str, str] = {}  # by Zenoh's id of a session: its certificate's name

    def feed(self, piece: bytes) -> Iterator[str]:
        """Take the next piece; what is to be told of it: warnings that are no refusals, and news of those."""
        *lines, self._rest = (self._rest + piece).split(b"\n")
        self._rest = self._rest[-4096:]
        for line in lines:
            plain = _COLOUR.sub(b"", line) if b"\x1b" in line else line
            if b"authorized to " in plain or _INTERCEPTED in plain:
                yield from self._access(plain)
            elif _STRANGER in plain:
                yield from self._count("certificate: of nobody in the mission")
            elif b"invalid peer certificate" in plain and (dialled := _DIALLED.search(_text(plain))):
                yield from self._count(f"dialling {dialled['endpoint']}: {_of_link(_text(plain))}")
            elif _LEVEL.match(plain) and not _NOBODY_THERE.search(plain):
                yield from self._warned(_text(plain))

    def _access(self, line: bytes) -> Iterator[str]:
        found = _THREAD.search(line)
        thread = found[1] if found else b""
        if line.endswith(_INTERCEPTED):
            said = self._said.pop(thread, "")
            if said:
                yield from self._count(said)
            return
        self._said.pop(thread, None)
        decision = _DECISION.search(_text(line)) if b"unauthorized to " in line else None
        if decision is None:
            return
        if decision["subject"]:
            self._learn(decision["zid"], decision["subject"])
        if decision["flow"] == "ingress":
            if len(self._said) >= KINDS:  # threads come and go
                self._said.clear()
            self._said[thread] = self._kind(decision)

    def _kind(self, decision: re.Match[str]) -> str:
        what = decision["what"].lower().replace("declare ", "").replace("undeclare ", "")
        key = decision["key"].removeprefix(self._prefix)
        name = self._names.get(decision["zid"])
        return f"{what} {key}" + (f" by {name}" if name else "")

    def _learn(self, zid: str, subject: str) -> None:
        name = _NAME.search(subject)
        if name is not None and zid not in self._names:
            if len(self._names) >= KINDS:
                self._names.pop(next(iter(self._names)))
            self._names[zid] = name[1]

    def _warned(self, line: str) -> Iterator[str]:
        found = _TARGET.match(line)
        if found is not None and found["target"].startswith(_LINK_MODULES):
            kind = _of_link(found["text"])
            if kind:
                yield from self._count(kind)
                return
        yield f"zenoh: {line}"

    def _count(self, kind: str) -> Iterator[str]:
        kind = "".join(c if c.isprintable() else "?" for c in kind)[:LONGEST]
        if kind not in self.counts and len(self.counts) >= KINDS:
            kind = OTHER
        self.counts[kind] += 1
        count = self.counts[kind]
        if str(count).strip("0") == "1":  # the 1st, 10th, 100th …: a flood of them is none of lines
            yield f"refused: {kind}" + (f", {count} times" if count > 1 else "")


class Refusals:
    """Listens to the log of this process's Zenoh. There is one per process, as there is one log."""

    _only: Refusals | None = None

    def __init__(self, reading: int, namespace: str) -> None:
        self._parser = Parser(namespace)
        self._reading = reading
        self._lock = threading.Lock()
        self._untold: deque[str] = deque()
        self._told, self._held, self._since = 0, 0, time.monotonic()
        threading.Thread(target=self._listen, name="refusals", daemon=True).start()
        atexit.register(self._tell)

    @classmethod
    def listen(cls, begin: Callable[[], object], namespace: str = "") -> Self | Refusals:
        """Start Zenoh's log with ``begin()``, which reads RUST_LOG, and listen to it; once per process.

        From then on file descriptor 1 is the log's, and `sys.stdout` writes to where that led before.
        """
        if cls._only is None:
            reading = _take_over_stdout()
            _begin(begin)
            cls._only = cls(reading, namespace)
        return cls._only

    @property
    def counts(self) -> Counter[str]:
        """How many were refused until now, by kind; a copy."""
        with self._lock:
            self._read()
            return self._parser.counts.copy()

    def _listen(self) -> None:
        more = True
        while more:
            with self._lock:
                more = self._read()
            self._tell()
            time.sleep(PERIOD)

    def _read(self) -> bool:
        """Read what there is; whether there may be more later. Logs nothing, for that may take its time."""
        for _ in range(64):  # then others have their turn
            try:
                piece = os.read(self._reading, 1 << 16)
            except BlockingIOError:
                return True
            if not piece:
                return False
            for line in self._parser.feed(piece):
                if len(self._untold) < WARNINGS:
                    self._untold.append(line)
                else:
                    self._held += 1
        return True

    def _tell(self) -> None:
        now = time.monotonic()
        if now - self._since > WINDOW:
            if self._held:
                _log.warning("zenoh: %d more warnings", self._held)
            self._told, self._held, self._since = 0, 0, now
        while self._untold:
            line = self._untold.popleft()
            if self._told < WARNINGS:
                _log.warning("%s", line)
                self._told += 1
            else:
                self._held += 1


def _take_over_stdout() -> int:
    """Put a pipe in the place of file descriptor 1; the end to read from."""
    out = sys.stdout
    out.flush()
    kept = os.dup(1)
    reading, writing = os.pipe()
    for end in (reading, writing):
        os.set_blocking(end, False)
    try:
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, PIPE)
    except OSError:  # not on this system, or not for us
        _log.debug("the log's pipe stays as small as it is")
    os.dup2(writing, 1)
    os.close(writing)
    sys.stdout = io.TextIOWrapper(
        os.fdopen(kept, "wb"), encoding=out.encoding, errors=out.errors, line_buffering=out.isatty()
    )
    return reading


def _begin(begin: Callable[[], object]) -> None:
    """Call `begin` with the environment that makes Zenoh's log ours, and what the user wants besides."""
    wanted = {"RUST_LOG": ",".join(filter(None, [os.environ.get("RUST_LOG"), FILTER])), "NO_COLOR": "1"}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        begin()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _of_link(text: str) -> str:
    """What was wrong with a link, as we call it; empty for what we have no name for."""
    return next((kind for sign, kind in _LINKS if sign in text), "")


def _text(line: bytes) -> str:
    return line[:1024].decode(errors="replace")
