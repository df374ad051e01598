"""What an agent and its watchdog agree on about `ALIVE`, the sign of life sent with each command.

The number is the time since the agent's start [s]. The last sign of life of an agent that ends well, after
its last zero command, is `FAREWELL`.
"""

from __future__ import annotations

FAREWELL = -1.0
"""Instead of a time: the robot was commanded to stand, and this agent will send no more commands."""
