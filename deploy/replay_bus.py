"""The Zenoh session on which `formation replay` speaks: on loopback unless flags lead elsewhere."""

from __future__ import annotations

import argparse
import socket
from contextlib import closing

from deploy.refusal import Refusal
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig, BusError, parse_override
from formation.transport.flags import add_zenoh
from formation.transport.wiring import AGENT_PORT
from monitor.replay.prefix import DEFAULT

HOST, LISTEN_PORT = "127.0.0.1", AGENT_PORT - 1
"""Where whoever wants to hear the messages dials, unless told otherwise."""
GIVEN_UP = ("transport/link/tx/queue/congestion_control/block/wait_before_close", "1000000")
"""A listener that takes nothing for a second has its link closed [us]."""


def add_links(options: argparse.ArgumentParser) -> None:
    """Add the flags that say where."""
    links = options.add_argument_group(
        "the messages on Zenoh, each as recorded, with what rode on it",
        f"By default whoever dials tcp/{HOST}:{LISTEN_PORT} hears them; if that is taken, another is said.",
    )
    links.add_argument("--no-zenoh", action="store_true", help="say nothing there")
    links.add_argument(
        "--prefix", default=DEFAULT, metavar="WORD",
        help=f"what keys begin with (default {DEFAULT}); no word that live keys begin with",
    )  # fmt: skip
    add_zenoh(links, connect="dial that; repeatable", listen="accept links there; repeatable")


def session(options: argparse.Namespace) -> Bus:
    """A session that only whoever dials it hears, unless flags say otherwise. Raises Refusal."""
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
    """The usual port, or another one where that is taken."""
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
    """How to reach it, in words; what a configuration file says of it is not known here."""
    ends = [f"listens at {end}" for end in options.listen] + [f"dials {end}" for end in options.connect]
    return f"; {', '.join(ends)}" if ends else ""
