"""What stands in a simulated world and is moved by nobody, and how it is said on the command line."""

from __future__ import annotations

import argparse
import math
from typing import NamedTuple


class Post(NamedTuple):
    """An upright cylinder."""

    at: complex
    """Its axis [m; world frame]."""
    radius: float
    """[m]"""


class Wall(NamedTuple):
    """A straight wall."""

    start: complex
    """[m; world frame]"""
    end: complex
    """[m; world frame]"""
    thickness: float = 0.02
    """[m]"""


def post(text: str) -> Post:
    """A post from "X,Y,RADIUS" [m]."""
    x, y, radius = _numbers(text, 3, "X,Y,RADIUS")
    if radius <= 0.0:
        raise argparse.ArgumentTypeError(f"{text}: RADIUS must be above 0")
    return Post(complex(x, y), radius)


def wall(text: str) -> Wall:
    """A wall from "X,Y,X,Y" [m]."""
    x, y, to_x, to_y = _numbers(text, 4, "X,Y,X,Y")
    if (x, y) == (to_x, to_y):
        raise argparse.ArgumentTypeError(f"{text}: must go from one point to another")
    return Wall(complex(x, y), complex(to_x, to_y))


def said(one: Post | Wall) -> str:
    """The flag that says it, as one word."""
    if isinstance(one, Post):
        return f"--post={one.at.real!r},{one.at.imag!r},{one.radius!r}"
    return f"--wall={one.start.real!r},{one.start.imag!r},{one.end.real!r},{one.end.imag!r}"


def _numbers(text: str, count: int, form: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise argparse.ArgumentTypeError(f"{text}: must be {form} in metres")
    return numbers
