"""The page's flags, for every command that serves a page."""

from __future__ import annotations

import argparse

from formation.monitor.web.address import HOST, PORT, Bind

EVERYBODY = """\
For this machine alone, unless --page names another address. --page 0.0.0.0:8460 shows it to every
machine that can reach this one: they see all robots, over plain HTTP that can be read on the way.
"""
ORDERS = """\
With --control they need the token to give orders, but plain HTTP carries the token, too. Do
that only in a network where every member may stop and drive the robots.
"""
CONTROL = """\
buttons for stop, hold, run and shape, shown if the page is opened by its whole address: the token in it is
new at every start\
"""


def add_page_flags(flags: argparse.ArgumentParser, *, control: bool = True) -> argparse._ArgumentGroup:
    """Add ``--page``, ``--no-page`` and, for a page that gives orders, ``--control``; return their group."""
    page = flags.add_argument_group("the live page", EVERYBODY + (ORDERS if control else ""))
    where = page.add_mutually_exclusive_group()
    where.add_argument(
        "--page", metavar="HOST:PORT", type=_bind,
        help=f"where to serve it (default: {HOST}:{PORT}, or any other port if that is taken)",
    )  # fmt: skip
    where.add_argument("--no-page", action="store_true", help="serve none, and no metrics for Prometheus")
    if control:
        page.add_argument("--control", action="store_true", help=CONTROL)
    return page


def _bind(text: str) -> Bind:
    try:
        return Bind.of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
