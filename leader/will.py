"""What the team is to do: what it was told, and a hold and a stop above it, each until it is ended."""

from __future__ import annotations

from typing import Literal

from formation.order import Mode, OperatorRequest, Order
from formation.rest import Rest, Result


class Will:
    """The mode of a candidate, and what an operator may change of it."""

    def __init__(self, *, hold: bool = False) -> None:
        """With `hold` the team waits until it is told to run."""
        self.told: Literal["hold", "run"] = "hold" if hold else "run"
        """What is in force without a stop or a hold."""
        self.rest = Rest()
        """The operator's stop and hold. Each candidate keeps them, also while another leads."""
        self.lost = ""
        """Why it cannot run, whatever it was told."""
        self._asked = False  # to run, which is newer than what is relayed

    @property
    def mode(self) -> Mode:
        """A stop outranks a hold, and a hold what it was told before."""
        return self.rest.mode or ("hold" if self.lost else self.told)

    def change(self, request: OperatorRequest, fact: str, *, leads: bool = True) -> Result:
        """Obey ``run``, ``hold``, ``stop`` or ``release``; `fact` is the id of what is then in force.

        A standby (`leads` is False) drops the hold that ``run`` ends; what the team is told to do it learns
        from the leader's order.
        """
        if request.do == "run" and leads and self.lost and not self.rest.stop:
            return Result(ok=False, reason=self.lost)
        result = self.rest.change(request, fact)
        if request.do == "run" and leads and result.ok:
            self.told, self._asked = "run", True
        return result

    def restore(self, order: Order) -> None:
        """Go on with what another leader was told. A stop or a hold that either was told stays."""
        self.inherit_stop(order)
        if self._asked:
            return
        self.told = order.told
        if order.holding:
            self.rest.hold = self.rest.hold or f"term-{order.term}"

    def inherit_stop(self, order: Order) -> None:
        """Be stopped if another leader was. An order has no ids, so the stop gets one of its own."""
        if order.mode == "stop":
            self.rest.stop = self.rest.stop or f"term-{order.term}"

    def stand_by(self) -> None:
        """Another leads: what the team is told to do is restored from its orders."""
        self.lost, self._asked = "", False
