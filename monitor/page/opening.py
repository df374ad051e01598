"""A page's server, opened where it was asked for or where there is room."""

from __future__ import annotations

from monitor.page.address import PORT, Bind, is_taken
from monitor.page.seams import Control, Replay
from monitor.page.server import PageServer
from monitor.page.source import Source

EXPOSED = (
    "whoever can read this network's traffic can read the page's token, and then stop and drive the robots"
)
"""What is to be known of orders by a page that others can reach."""


def opened(
    asked: Bind | None, source: Source, control: Control | None = None, replay: Replay | None = None
) -> PageServer:
    """A server where it was `asked` for, by default at the usual place or, if that is taken, at any.

    It has the port and does not serve yet. Raises OSError for a place that was asked for and cannot be had.
    """
    try:
        return PageServer(asked or Bind(), source, control, replay)
    except OSError as error:
        if asked is not None or not is_taken(error):
            raise
    return PageServer(Bind(port=0), source, control, replay)


def words(asked: Bind | None, server: PageServer) -> str:
    """Where the page is, for a log: the token is left out, where it is said is not."""
    usual = asked is not None or server.address == Bind().url(PORT)
    where = server.address if usual else f"{server.address} (port {PORT} is taken)"
    invites = server.invitation != server.address
    return f"{where}; to give orders, the one in the ready line" if invites else where
