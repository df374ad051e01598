"""The Zenoh session of `formation replay`: on loopback by default."""

from __future__ import annotations

import argparse
import socket
from contextlib import closing

from formation.deploy.refusal import Refusal
from formation.monitor.replay.echo import DEFAULT
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError, parse_override
from formation.transport.runtime.flags import add_zenoh
from formation.transport.wiring import AGENT_PORT

HOST, LISTEN_PORT = "127.0.0.1", AGENT_PORT - 1
"""Default address to dial for the messages."""
GIVEN_UP = ("transport/link/tx/queue/congestion_control/block/wait_before_close", "1000000")
"""Time after which the link of a listener that takes nothing is closed [us]."""


def add_links(options: argparse.ArgumentParser) -> None:
    """Add the flags for links."""
    links = options.add_argument_group(
        "the messages on Zenoh, each as recorded, with its attachment",
        f"By default a process that dials tcp/{HOST}:{LISTEN_PORT} receives them; if taken, another port"
        " is used, and printed.",
    )
    links.add_argument("--no-zenoh", action="store_true", help="publish nothing there")
    links.add_argument(
        "--prefix", default=DEFAULT, metavar="WORD",
        help=f"what keys begin with (default {DEFAULT}); no word that live keys begin with",
    )  # fmt: skip
    add_zenoh(links, connect="dial that; repeatable", listen="accept links there; repeatable")


def session(options: argparse.Namespace) -> Bus:
    """Return a session that only processes that dial it receive, by default. Raises Refusal."""
    linked = options.listen or options.connect or options.mode == "client"
    if not linked and options.config is None:
        options.listen = [f"tcp/{HOST}:{_free_port()}"]
    try:
        return Bus(
            BusConfig(
                listen=tuple(options.listen),
                connect=tuple(options.connect),
                mode=options.mode,
                config_file=options.config,
                overrides=(GIVEN_UP, *(parse_override(text) for text in options.cfg)),
                name="replay",
            )
        )
    except BusError as error:
        raise Refusal(str(error)) from None


def _free_port() -> int:
    """Return the usual port, or another one if that is taken."""
    for port in (LISTEN_PORT, 0):
        with closing(socket.socket()) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise Refusal(f"there is no free port at {HOST} for the messages: name one with -l, or say --no-zenoh")


def where(options: argparse.Namespace) -> str:
    """Return in words how to reach it, without settings from a configuration file."""
    ends = [f"listens at {end}" for end in options.listen] + [f"dials {end}" for end in options.connect]
    return f"; {', '.join(ends)}" if ends else ""
