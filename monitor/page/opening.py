"""The page as flags ask for it: where it is served, and what happens where somebody else is."""

from __future__ import annotations

import argparse
import logging

from monitor.page.address import HOST, PORT, Bind, is_taken
from monitor.page.server import Control, PageServer, Replay
from monitor.page.source import Source

EVERYBODY = """\
For this machine alone, unless --page names another address. --page 0.0.0.0:8460 shows it to everybody
who can reach this machine: they see all robots, over plain HTTP that whoever is on the way can read. With
--control they need the token to give orders, but who can read the traffic can read the token, too. Do that
only in a network whose every member may stop and drive the robots.
"""
_log = logging.getLogger(__name__)


def add_page_flags(flags: argparse.ArgumentParser) -> None:
    """Add ``--page`` and ``--no-page``."""
    page = flags.add_argument_group("the live page", EVERYBODY)
    where = page.add_mutually_exclusive_group()
    where.add_argument(
        "--page", metavar="HOST:PORT", type=_bind,
        help=f"where to serve it (default: {HOST}:{PORT}, or any other port if that is taken)",
    )  # fmt: skip
    where.add_argument("--no-page", action="store_true", help="serve none, and no figures for Prometheus")


def opened(
    asked: Bind | None, source: Source, control: Control | None = None, replay: Replay | None = None
) -> PageServer:
    """A server where it was `asked` for, by default at the usual place or, if that is taken, at any.

    Raises OSError for a place that was asked for and cannot be had.
    """
    try:
        return PageServer(asked or Bind(), source, control, replay)
    except OSError as error:
        if asked is not None or not is_taken(error):
            raise
    _log.info("port %d is taken, so the page is at another", PORT)
    return PageServer(Bind(port=0), source, control, replay)


def _bind(text: str) -> Bind:
    try:
        return Bind.of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
