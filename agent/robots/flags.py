"""The flags that say in which world simulated robots are, for whoever starts them."""

from __future__ import annotations

import argparse
import os
from ctypes.util import find_library
from pathlib import Path

NEEDED = ("mujoco", "PIL")
"""Packages of the physics world."""


def add_world_flags(to: argparse.ArgumentParser) -> None:
    """Which world robots are in, and whether to take a picture of it."""
    group = to.add_argument_group("the world of the simulated robots")
    group.add_argument(
        "--world",
        choices=("kinematic", "mujoco"),
        default="kinematic",
        help="robots that do as they are told, or physics with mass, motors, slip and contacts, which needs"
        " formation[physics] (default: kinematic)",
    )
    group.add_argument(
        "--picture", metavar="FILE.png", type=Path, help="with mujoco: a picture of the world at the end"
    )


def unfit(args: argparse.Namespace) -> str | None:
    """Which of these flags cannot be, and why; None if all can."""
    if args.picture is None:
        return None
    if args.world != "mujoco":
        return "--picture: needs --world mujoco"
    if not args.picture.absolute().parent.is_dir():
        return f"--picture {args.picture}: there is no folder {args.picture.parent}"
    if not os.access(args.picture.absolute().parent, os.W_OK):
        return f"--picture {args.picture}: the folder cannot be written to"
    if "MUJOCO_GL" not in os.environ and find_library("EGL") is None:
        return "--picture: needs EGL to render; on Debian and Ubuntu: apt install libegl1"
    return None


def world_flags(args: argparse.Namespace) -> tuple[str, ...]:
    """The same flags for another process."""
    world = () if args.world == "kinematic" else ("--world", args.world)
    return world if args.picture is None else (*world, "--picture", str(args.picture))
