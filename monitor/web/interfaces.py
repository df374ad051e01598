"""Interfaces behind the page: one that gives orders, one that plays a recording."""

from __future__ import annotations

from typing import Any, Protocol


class Control(Protocol):
    """Carries an operator's orders to the fleet."""

    @property
    def token(self) -> str:
        """The token required in a request for an order."""

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Give an order and return the answers, as in `formation order --json`.

        `what` are its values: a ``shape``, ``degrees`` and so on, see `formation.protocol.order.TAKES`.
        `click` is the page's own id of the click, the same if it is sent twice; `seen` is the moment that
        the page showed [s, our system clock]. Called in threads of the server, perhaps in several at once.
        ValueError if the order is not possible now.
        """


class Replay(Protocol):
    """Plays a recording."""

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        """Pause, play, seek to a time [s, system clock], or set the speed; return the new state.

        Called in threads of the server. ValueError for an invalid request.
        """
