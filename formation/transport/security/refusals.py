"""Zenoh's refusals, counted by kind: messages forbidden by access control, and links without proof.

Zenoh reports refusals only in its log, which goes to file descriptor 1. So a pipe replaces that, and the
process's own output on stdout goes to the earlier destination. Zenoh's end of the pipe never blocks:
excess text is lost, and with it a count, but neither a message nor time. Other lines of at least warning
level are logged as our own.

Of access control the log has two lines for a refused message, from one thread and directly after each
other::

    … ThreadId(02) …: ZID on …+CertCommonName(robot2)+… is unauthorized to Put (ingress) on KEY
    … ThreadId(02) …: Msg intercepted!

The first alone only means that Zenoh has cached its decision. Later messages on a declared key have
``Using cached result: ZID is unauthorized to …`` instead, without the name. Refused egress is no attack:
this process so withholds messages that are not for others.
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
"""``RUST_LOG`` with which Zenoh logs its refusals."""
MAX_KINDS = 64
"""Most kinds that are counted separately, further ones are `OTHER`: the refused sender chooses the keys."""
OTHER = "other"
MAX_KIND_CHARS = 100
"""Greatest length of a kind [characters]."""
PIPE_BYTES = 1 << 20
"""Size of the pipe for the log [bytes]; the system may give less."""
PIECE_BYTES, MAX_PIECES = 1 << 16, 256
"""Most that is read from the pipe at once [bytes], and that waits in memory to be parsed."""
READ_PERIOD, BURST_READ_PERIOD = 0.1, 0.005
"""Period of reading the log [s]: usually, and for `BURST_TIME` after the start or a burst."""
BURST_BYTES, BURST_TIME = 1 << 15, 5.0
"""So much read at once is a burst [bytes]: for each new link Zenoh logs what every key may do, megabytes with
many peers. What the pipe cannot take, Zenoh reports on stderr, with two lines for each that is lost."""
MAX_WARNINGS, WARNING_WINDOW_TIME = 20, 10.0
"""Most of Zenoh's other warnings that are passed on, per time [s]; the rest is only counted."""

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
"""Zenoh's messages about a refused link, and our names for them; the first match counts."""
_LINK_MODULES = ("zenoh_link_tls", "zenoh_link_commons::tls")
_NOBODY_THERE = re.compile(rb"runtime::orchestrator: Unable to connect to (any of|tcp/|tls/|quic/|udp/)")
"""Logged twice a second while a router is missing, which the dialling process reports itself, once."""
_DIALLED = re.compile(r"Unable to connect to configured peer (?P<endpoint>\S+)! .*?invalid peer certificate")
_STRANGER = b"did not match any configured ACL subject"
_log = logging.getLogger(__name__)


class Parser:
    """Parses Zenoh's log in pieces of any size."""

    def __init__(self, namespace: str = "") -> None:
        """`namespace` is the fleet's, which is removed from keys."""
        self.counts: Counter[str] = Counter()
        """Refusals by kind, such as ``put robot3/position by robot2``."""
        self._prefix = f"{namespace}/" if namespace else ""
        self._rest = b""
        self._pending: dict[bytes, str] = {}  # by thread: its pending refusal, if any
        self._names: dict[str, str] = {}  # by Zenoh's id of a session: the name in its certificate

    def feed(self, piece: bytes) -> Iterator[str]:
        """Parse the next piece; return what to log: other warnings, and new refusals."""
        *lines, self._rest = (self._rest + piece).split(b"\n")
        self._rest = self._rest[-4096:]
        for line in lines:
            plain = _COLOUR.sub(b"", line) if b"\x1b" in line else line
            if b"authorized to " in plain or _INTERCEPTED in plain:
                yield from self._access(plain)
            elif _STRANGER in plain:
                yield from self._count("certificate: of no process in the mission")
            elif b"invalid peer certificate" in plain and (dialled := _DIALLED.search(_text(plain))):
                yield from self._count(f"dialling {dialled['endpoint']}: {_of_link(_text(plain))}")
            elif _LEVEL.match(plain) and not _NOBODY_THERE.search(plain):
                yield from self._warned(_text(plain))

    def _access(self, line: bytes) -> Iterator[str]:
        found = _THREAD.search(line)
        thread = found[1] if found else b""
        if line.endswith(_INTERCEPTED):
            refusal = self._pending.pop(thread, "")
            if refusal:
                yield from self._count(refusal)
            return
        self._pending.pop(thread, None)
        decision = _DECISION.search(_text(line)) if b"unauthorized to " in line else None
        if decision is None:
            return
        if decision["subject"]:
            self._learn(decision["zid"], decision["subject"])
        if decision["flow"] == "ingress":
            if len(self._pending) >= MAX_KINDS:  # threads come and go
                self._pending.clear()
            self._pending[thread] = self._kind(decision)

    def _kind(self, decision: re.Match[str]) -> str:
        what = decision["what"].lower().replace("declare ", "").replace("undeclare ", "")
        key = decision["key"].removeprefix(self._prefix)
        name = self._names.get(decision["zid"])
        return f"{what} {key}" + (f" by {name}" if name else "")

    def _learn(self, zid: str, subject: str) -> None:
        name = _NAME.search(subject)
        if name is not None and zid not in self._names:
            if len(self._names) >= MAX_KINDS:
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
        kind = "".join(c if c.isprintable() else "?" for c in kind)[:MAX_KIND_CHARS]
        if kind not in self.counts and len(self.counts) >= MAX_KINDS:
            kind = OTHER
        self.counts[kind] += 1
        count = self.counts[kind]
        if str(count).strip("0") == "1":  # the 1st, 10th, 100th …: a flood of them must not flood the log
            yield f"refused: {kind}" + (f", {count} times" if count > 1 else "")


class Refusals:
    """Reads the log of this process's Zenoh. There is one per process, as there is one log."""

    _only: Refusals | None = None

    def __init__(self, reading: int, namespace: str) -> None:
        self._parser = Parser(namespace)
        self._reading = reading
        self._lock, self._logging = threading.Lock(), threading.Lock()
        self._pieces: deque[bytes] = deque()  # read, not parsed yet
        self._unlogged: deque[str] = deque()
        self._logged, self._held, self._since = 0, 0, time.monotonic()
        self._burst = self._since  # time of the last burst [s, monotonic]
        threading.Thread(target=self._listen, name="refusals", daemon=True).start()
        atexit.register(self._log_lines)

    @classmethod
    def listen(cls, begin: Callable[[], object], namespace: str = "") -> Self | Refusals:
        """Start Zenoh's log with ``begin()``, which reads RUST_LOG, and read it; once per process.

        From then on file descriptor 1 is the log's, and `sys.stdout` writes to its earlier destination.
        """
        if cls._only is None:
            reading = _take_over_stdout()
            _begin(begin)
            cls._only = cls(reading, namespace)
        return cls._only

    @property
    def counts(self) -> Counter[str]:
        """Number of refusals until now, by kind; a copy."""
        with self._lock:
            self._read()
            return self._parser.counts.copy()

    def _listen(self) -> None:
        more = True
        while more:
            with self._lock:
                more = self._read()
            self._log_lines()
            quiet = time.monotonic() - self._burst > BURST_TIME
            time.sleep(READ_PERIOD if quiet else BURST_READ_PERIOD)

    def _read(self) -> bool:
        """Parse what is available; whether more may follow. Logs nothing, because logging may take long."""
        for _ in range(64):  # then other threads may run
            is_open = self._empty_pipe()
            if not self._pieces:
                return is_open
            for line in self._parser.feed(self._pieces.popleft()):
                if len(self._unlogged) < MAX_WARNINGS:
                    self._unlogged.append(line)
                else:
                    self._held += 1
        return True

    def _empty_pipe(self) -> bool:
        """Move the log from the pipe to memory, quicker than it is parsed; whether the pipe is open."""
        size = 0
        while len(self._pieces) < MAX_PIECES:
            try:
                piece = os.read(self._reading, PIECE_BYTES)
            except BlockingIOError:
                break
            if not piece:
                return False
            self._pieces.append(piece)
            size += len(piece)
        if size >= BURST_BYTES:
            self._burst = time.monotonic()
        return True

    def _log_lines(self) -> None:
        with self._logging:  # a line that another thread has taken is logged before the process ends
            now = time.monotonic()
            if now - self._since > WARNING_WINDOW_TIME:
                if self._held:
                    _log.warning("zenoh: %d more warnings", self._held)
                self._logged, self._held, self._since = 0, 0, now
            while self._unlogged:
                line = self._unlogged.popleft()
                if self._logged < MAX_WARNINGS:
                    _log.warning("%s", line)
                    self._logged += 1
                else:
                    self._held += 1


def _take_over_stdout() -> int:
    """Replace file descriptor 1 by a pipe; return the end to read from."""
    out = sys.stdout
    out.flush()
    kept = os.dup(1)
    reading, writing = os.pipe()
    for end in (reading, writing):
        os.set_blocking(end, False)
    try:
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
    except OSError:  # not supported by this system, or not permitted
        _log.debug("the log's pipe stays as small as it is")
    os.dup2(writing, 1)
    os.close(writing)
    sys.stdout = io.TextIOWrapper(
        os.fdopen(kept, "wb"), encoding=out.encoding, errors=out.errors, line_buffering=out.isatty()
    )
    return reading


def _begin(begin: Callable[[], object]) -> None:
    """Call `begin` with the environment for our log of Zenoh, plus the user's own filter."""
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
    """Our name for the fault of a link; empty if there is none."""
    return next((kind for sign, kind in _LINKS if sign in text), "")


def _text(line: bytes) -> str:
    return line[:1024].decode(errors="replace")
