"""Open a page's server at the requested address or at a free one."""

from __future__ import annotations

from formation.monitor.web.address import PORT, Bind, is_taken
from formation.monitor.web.interfaces import Control, Replay
from formation.monitor.web.server import PageServer
from formation.monitor.web.source import Source

EXPOSED = "this page's token can be read by any machine on the way, which can then stop and drive the robots"
"""Warning about orders from a page that others can reach."""


def opened(
    requested: Bind | None, source: Source, control: Control | None = None, replay: Replay | None = None
) -> PageServer:
    """Return a server at the `requested` address, by default at the usual port or, if that is taken, at any.

    It has the port and does not serve yet. Raises OSError if the requested address cannot be had.
    """
    try:
        return PageServer(requested or Bind(), source, control, replay)
    except OSError as error:
        if requested is not None or not is_taken(error):
            raise
    return PageServer(Bind(port=0), source, control, replay)


def words(requested: Bind | None, server: PageServer) -> str:
    """Return the page's address for a log: without the token, but with the place to read it."""
    usual = requested is not None or server.address == Bind().url(PORT)
    where = server.address if usual else f"{server.address} (port {PORT} is taken)"
    invites = server.invitation != server.address
    return f"{where}; to give orders, the one in the ready line" if invites else where
