"""Constraints of the control pipeline on wanted commands, for a robot with nothing around it."""

from __future__ import annotations

from formation.control.controller import Gains, Measured
from formation.control.laws import LAWS
from formation.control.pipeline import ControlState, Inputs, constrained
from formation.control.unicycle import AT_REST, Command
from formation.mission.model import Mission

NOTHING = Measured(0j, 0j, 1)


class ConstrainedCommands:
    """The stages after the law, with their state."""

    def __init__(self, mission: Mission, robot: str) -> None:
        self._params, self._state = mission.control(robot, LAWS["field"]), ControlState()
        self.newest = AT_REST
        """The newest command."""

    def put(self, moment: float, wanted: Command) -> Command:
        """Return the command at `moment` [s] for the wanted one."""
        inputs = Inputs(moment, 0.0, 1.0 + 0.0j, NOTHING, Gains(1.0, 0.0))
        self._state, outcome = constrained(self._state, wanted, inputs, (), self._params)
        self.newest = outcome.command
        return outcome.command
