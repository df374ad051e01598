"""What an agent and its guard agree on about `ALIVE`, the sign of life that goes with each command.

The number is the time since the agent's start [s]. An agent that ends well takes its leave: its last sign of
life, after its last zero command, is `FAREWELL`.
"""

from __future__ import annotations

FAREWELL = -1.0
"""No time since a start: the robot was told to stand, and this agent will send no more commands."""
