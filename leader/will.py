"""What the team is to do: what it was told, a hold and a stop above it, each until it is released."""

from __future__ import annotations

from typing import Literal

from formation.order import Do, Mode, Order


class Will:
    """The mode of the leader, and what an operator may change of it."""

    def __init__(self, *, hold: bool = False) -> None:
        """With `hold` the team waits until it is told to run."""
        self.told: Literal["hold", "run"] = "hold" if hold else "run"
        """What is in force once nothing is left to release."""
        self.holding = False
        """An operator asked for it."""
        self.stopped = False
        """Latched until it is released."""
        self.lost = ""
        """Why it cannot run, whatever it was told."""
        self._asked = False  # to run or to hold, which is newer than what is relayed

    @property
    def mode(self) -> Mode:
        """A stop outranks a hold, and a hold what it was told before."""
        if self.stopped:
            return "stop"
        return "hold" if self.holding or self.lost else self.told

    def change(self, wanted: Do) -> tuple[bool, str]:
        """Obey ``run``, ``hold``, ``stop`` or ``release``; whether it does, and what there is to say."""
        if wanted == "run" and self.stopped:
            return False, "stopped: release it first"
        if wanted == "run" and self.lost:
            return False, self.lost
        if wanted == "run":
            self.told, self.holding, self._asked = "run", False, True
        elif wanted == "hold":
            self.holding, self._asked = True, True
        elif wanted == "stop":
            self.stopped = True
        elif self.stopped:
            self.stopped = False
        elif self.holding:
            self.holding, self._asked = False, True
        else:
            return True, "there was nothing to release"
        return True, ""

    def restore(self, order: Order) -> None:
        """Go on with what another leader was told. A stop that was heard by either stays."""
        self.stopped = self.stopped or order.mode == "stop"
        if not self._asked:
            self.told, self.holding = order.told, order.holding

    def stand_by(self) -> None:
        """Somebody else leads: what it wants is what is to be restored."""
        self.holding, self.lost, self._asked = False, "", False
