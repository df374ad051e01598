"""The page's flags, for whoever serves one or has one served."""

from __future__ import annotations

import argparse

from monitor.page.address import HOST, PORT, Bind

EVERYBODY = """\
For this machine alone, unless --page names another address. --page 0.0.0.0:8460 shows it to everybody
who can reach this machine: they see all robots, over plain HTTP that whoever is on the way can read.
"""
ORDERS = """\
With --control they need the token to give orders, but who can read the traffic can read the token, too. Do
that only in a network whose every member may stop and drive the robots.
"""
CONTROL = """\
buttons for stop, hold, run and shape, for who opens the page by its whole address: the token in it is new at
every start\
"""


def add_page_flags(flags: argparse.ArgumentParser, *, control: bool = True) -> argparse._ArgumentGroup:
    """Add ``--page``, ``--no-page`` and, for a page that gives orders, ``--control``; their group."""
    page = flags.add_argument_group("the live page", EVERYBODY + (ORDERS if control else ""))
    where = page.add_mutually_exclusive_group()
    where.add_argument(
        "--page", metavar="HOST:PORT", type=_bind,
        help=f"where to serve it (default: {HOST}:{PORT}, or any other port if that is taken)",
    )  # fmt: skip
    where.add_argument("--no-page", action="store_true", help="serve none, and no figures for Prometheus")
    if control:
        page.add_argument("--control", action="store_true", help=CONTROL)
    return page


def _bind(text: str) -> Bind:
    try:
        return Bind.of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
