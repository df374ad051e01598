"""Who stands behind the page: the one who carries orders, the one who plays a recording."""

from __future__ import annotations

from typing import Any, Protocol


class Control(Protocol):
    """Who carries an operator's orders to the fleet."""

    @property
    def token(self) -> str:
        """What a request has to bring to be obeyed."""

    def order(self, do: str, *, click: str = "", seen: float | None = None, **what: Any) -> dict[str, Any]:
        """Give an order and wait for the answers, as `formation order --json` has them.

        `what` belongs to it: a ``shape``, ``degrees`` and so on, see `formation.order.TAKES`.
        `click` is the page's own name of what somebody clicked, the same if it is sent twice; `seen` is the
        moment that the page showed [s, our system clock]. Called in threads of the server, perhaps in
        several at once. ValueError for what cannot be ordered just now.
        """


class Replay(Protocol):
    """Who plays a recording."""

    def steer(self, do: str, to: float | None) -> dict[str, Any]:
        """Pause, play, seek to a time [s, system clock], or set the speed; how it stands then.

        Called in threads of the server. ValueError for what cannot be.
        """
