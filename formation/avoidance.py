"""What a robot is to keep clear of."""

from __future__ import annotations

from typing import NamedTuple


class Obstacle(NamedTuple):
    """A disc that the body must not touch."""

    at: complex
    """Its centre, from the robot's [m; body frame]."""
    radius: float
    """[m]"""
    velocity: complex
    """[m/s; body frame]"""
    first: bool
    """Whether it has right of way."""
