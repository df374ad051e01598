"""Rule of rounding: to a robot's steps, commands add up to what was wanted."""

from __future__ import annotations

from formation.agent.core import Agent
from formation.control.unicycle import AT_REST, Command
from formation.deploy.rehearsal.places import Tell
from formation.mission.model import Mission

MAX_ROUNDED_STEPS = 1.5
"""By how many steps the sums of what is wanted and what is commanded may differ; one remains."""


class Rounding:
    """What rounding has left out of the commands of a mission's robots."""

    def __init__(self, mission: Mission, tell: Tell) -> None:
        self._mission, self._tell = mission, tell
        self._left: dict[str, Command] = {}  # since each robot was commanded to stand [m/s; rad/s]

    def check(self, name: str, agent: Agent, command: Command) -> None:
        """Check an agent's newest command."""
        spec, state = self._mission.robots[name], agent.commander.state
        before, self._left[name] = self._left.get(name, AT_REST), AT_REST
        if command == AT_REST:
            return
        steps, limits = (spec.speed_step, spec.turn_rate_step), (spec.max_speed, spec.max_turn_rate)
        each = zip(before, state.ramp.before, command, state.remainder, steps, limits, strict=True)
        left = [
            remainder if abs(sent) > limit - step else was + wanted - sent  # at a limit it is cut off
            for was, wanted, sent, remainder, step, limit in each
        ]
        self._left[name] = Command(*left)
        for rounded, step in zip(left, steps, strict=True):
            if step > 0.0 and abs(rounded) > MAX_ROUNDED_STEPS * step:
                self._tell("steps", name, f"commands are {rounded:g} less than wanted, in steps of {step:g}")
