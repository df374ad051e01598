"""Configuration of a process's bus: the flags known from Zenoh as one frozen value, and defaults."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

from formation.transport.wiring import Links

MODES = ("peer", "client", "router")
_NETWORK = ("tcp", "tls", "quic", "udp", "ws")
_OTHER = ("unixsock-stream", "unixpipe", "serial", "vsock")
_ADDRESS = re.compile(r"(\[[0-9A-Fa-f:.]+(%\w+)?\]|[^\s:/\[\]?#]+):(?P<port>\d{1,5})(\?[^#\s]*)?(#\S*)?")
_NAMESPACE = re.compile(r"[^\s/*$?#@]+(/[^\s/*$?#@]+)*")

THREADS = (
    "(rx: (handover: app), acc: (handover: app), tx: (worker_threads: 1), net: (handover: app),"
    " app: (worker_threads: 1))"
)
"""``ZENOH_RUNTIME``: one thread that sends, and one for all else. At these rates more only cost memory.

On one thread alone Zenoh waits for itself: its answers while it receives (to queries without a queryable,
and about its admin space) need space in the send queue, and twenty at once find none. Zenoh, and every
publishing thread, then blocked for seconds, until the link was given up.
"""

DEFAULTS: tuple[tuple[str, str], ...] = (
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "false"),
    ("listen/endpoints", "[]"),  # Zenoh's own default accepts links on every interface
    # Start at once, whether or not the peers to dial exist; dial missing ones for ever, after 0.2 to 1 s.
    ("open/return_conditions/connect_scouted", "false"),
    ("connect/retry", "{period_init_ms: 200, period_max_ms: 1000, period_increase_factor: 2}"),
    # A peer that hangs or is unplugged is given up after its own lease, as announced [ms].
    ("transport/link/tx/lease", "1000"),
    ("transport/link/tx/keep_alive", "4"),
    # How many messages may wait to be sent, per priority, and how long one waits for space before it is
    # dropped [us]. Zenoh's own 2 and 1000 lose some on a busy machine; a link that jams costs one such wait.
    ("transport/link/tx/queue/size/real_time", "16"),
    ("transport/link/tx/queue/size/data", "16"),
    ("transport/link/tx/queue/size/background", "16"),
    ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", "5000"),
    ("transport/link/rx/max_message_size", "1048576"),  # [bytes]; Zenoh's own default would allocate 1 GiB
    ("transport/shared_memory/enabled", "false"),
    ("timestamping/enabled", "{router: false, peer: false, client: false}"),
)
"""Paths in Zenoh's configuration and their JSON5: a sparse peer that quickly detects a dead one."""


class BusError(RuntimeError):
    """The bus cannot be opened or used so; the text names the flag or key and the legal values."""


@dataclass(frozen=True, slots=True)
class BusConfig:
    """Endpoints on which a session listens and that it dials. Raises BusError if that cannot work.

    Sparse peers: no multicast, no gossip, so a session has exactly the links that `listen` and `connect`
    make. Values in `config_file` that differ from Zenoh's own default replace ours; flags take precedence
    over the file, the file over the mission, and `overrides` over everything.
    """

    listen: tuple[str, ...] = ()
    """Endpoints to accept links on, ``tcp/0.0.0.0:7447``; port 0 takes a free one. Empty: accepts no
    links."""
    connect: tuple[str, ...] = ()
    """Endpoints to dial, repeatedly while they are missing."""
    implied: Links | None = None
    """The mission's endpoints to listen on and dial, if neither flags nor the file name any."""
    mode: str | None = None
    """One of `MODES`; None is the file's, else peer."""
    namespace: str = ""
    """Prefix of every key on the network, invisible here: keeps two fleets on one network apart."""
    config_file: Path | None = None
    """Zenoh configuration, JSON5."""
    overrides: tuple[tuple[str, str], ...] = ()
    """Paths in Zenoh's configuration and their values in JSON5 (``--cfg PATH:VALUE``)."""
    adminspace: bool = True
    """Whether other sessions may read this one's links and subscriptions under ``@/``."""
    name: str = ""
    """Name of this process in its admin space."""
    connect_flag: str = "--connect"
    """The flag that names endpoints to dial, for errors."""

    def __post_init__(self) -> None:
        implied = self.implied or Links((), ())
        for flag, endpoints in (
            ("--listen", self.listen + implied.listen),
            (self.connect_flag, self.connect + implied.connect),
        ):
            for endpoint in endpoints:
                _check_endpoint(flag, endpoint)
        if self.mode is not None and self.mode not in MODES:
            raise BusError(f"--mode {self.mode!r}: must be one of {', '.join(MODES)}")
        if self.namespace and not _NAMESPACE.fullmatch(self.namespace):
            raise BusError(f"--namespace {self.namespace!r}: must be words joined by '/', without * $ ? # @")

    def flags(self) -> list[tuple[str, str]]:
        """The settings of the flags: paths in Zenoh's configuration and their JSON."""
        flags = {
            "mode": self.mode,
            "listen/endpoints": self.listen,
            "connect/endpoints": self.connect,
            "namespace": self.namespace,
            "metadata": {"name": self.name} if self.name else None,
            "adminspace": {"enabled": self.adminspace, "permissions": {"read": True, "write": False}},
        }
        return [(path, json.dumps(value)) for path, value in flags.items() if value]

    def links(self) -> list[tuple[str, str]]:
        """The implied links, for a session without endpoints of flags or file."""
        if self.implied is None:
            return []
        return [
            ("listen/endpoints", json.dumps(self.implied.listen)),
            ("connect/endpoints", json.dumps(self.implied.connect)),
        ]


def parse_override(text: str) -> tuple[str, str]:
    """``PATH:VALUE`` of a ``--cfg`` flag as a pair. Raises BusError."""
    path, colon, value = text.partition(":")
    if not path or not colon or not value:
        raise BusError(f"--cfg {text!r}: must be PATH:VALUE, for example transport/link/tx/lease:2000")
    return path, value


def plain(error: Exception) -> str:
    """One line of Zenoh's error, without the places in its source code that it names."""
    quoted = re.search(r'msg: "(.*?)", location', str(error), re.DOTALL)
    text = re.sub(r" at \S+\.rs:\d+\.?", "", quoted[1] if quoted else str(error)).replace(r"\n", " ")
    return " ".join(text.split())


def _check_endpoint(flag: str, endpoint: str) -> None:
    protocol, _, address = endpoint.partition("/")
    if protocol in _OTHER and address:
        return
    match = _ADDRESS.fullmatch(address)
    lowest = 0 if flag == "--listen" else 1
    if protocol not in _NETWORK or match is None or not lowest <= int(match["port"]) <= 65535:
        raise BusError(
            f"{flag} {endpoint!r}: must be PROTOCOL/HOST:PORT with one of {', '.join(_NETWORK)} and a port"
            f" from {lowest} to 65535, for example tcp/192.168.1.12:7447"
        )
