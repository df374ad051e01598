"""The team's mode: run or hold, overridden by a hold and by a stop until each is ended."""

from __future__ import annotations

from typing import Literal

from formation.protocol.order import Mode, OperatorRequest, Order
from formation.protocol.reasons import Reason
from formation.protocol.stops import Rest, Result


class TeamMode:
    """The mode of a candidate, and how an operator changes it."""

    def __init__(self, *, hold: bool = False) -> None:
        """With `hold`, the team waits until told to run, unless it is under way."""
        self.base_mode: Literal["hold", "run"] = "hold" if hold else "run"
        """The mode in force without a stop or a hold."""
        self.rest = Rest()
        """The operator's stop and hold. Each candidate keeps them, also while another leads."""
        self.lost: Reason | None = None
        """Why it cannot run even if told to."""
        self._hold = hold
        self._run_requested = False  # told to run, which is newer than the relayed order

    @property
    def mode(self) -> Mode:
        """The mode in force: a stop overrides a hold, and a hold the base mode."""
        return self.rest.mode or ("hold" if self.lost else self.base_mode)

    def change(self, request: OperatorRequest, fact: str, *, leads: bool = True) -> Result:
        """Obey ``run``, ``hold``, ``stop`` or ``release``; `fact` is the id of the resulting stop or hold.

        A standby (`leads` is False) drops the hold that ``run`` ends; the rest comes from the leader's
        order.
        """
        if request.do == "run" and leads and self.lost and not self.rest.stop:
            return Result(ok=False, reason=str(self.lost))
        result = self.rest.change(request, fact)
        if request.do == "run" and leads and result.ok:
            self.base_mode, self._run_requested = "run", True
        return result

    def restore(self, order: Order, *, under_way: bool = True) -> None:
        """Take over another leader's mode. A stop or a hold of either stays.

        `under_way`: its beat rose a moment ago. If not, one that was started to hold waits for ``run``.
        """
        self.inherit_stop(order)
        if self._run_requested:
            return
        self.base_mode = order.base_mode if under_way or not self._hold else "hold"
        if order.holding:
            self.rest.hold = self.rest.hold or f"term-{order.term}"

    def inherit_stop(self, order: Order) -> None:
        """Stop if another leader was stopped. An order has no ids, so the stop gets a new one."""
        if order.mode == "stop":
            self.rest.stop = self.rest.stop or f"term-{order.term}"

    def replace_lost(self) -> bool:
        """Forget the lost route, which an order replaces; only ``run`` starts the team on the other one.

        Return whether a route was lost.
        """
        if self.lost is None:
            return False
        self.lost, self.base_mode = None, "hold"
        return True

    def end(self) -> None:
        """Leave a hold to the next leader: an operator has ended this one, and no other takes its place."""
        self.base_mode = "hold"

    def stand_by(self) -> None:
        """Become a standby: the mode is later restored from the leader's orders."""
        self.lost, self._run_requested = None, False
