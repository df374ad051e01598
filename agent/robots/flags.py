"""The flags that say in which world simulated robots are, for whoever starts them."""

from __future__ import annotations

import argparse
import os
from ctypes.util import find_library
from pathlib import Path

from agent.robots.obstacles import post, said, wall

NEEDS_MUJOCO = ("post", "wall", "picture")
"""Flags of what only the physics world has."""


def add_world_flags(to: argparse.ArgumentParser) -> None:
    """Which world robots are in, and what stands in it."""
    group = to.add_argument_group("the world of the simulated robots")
    group.add_argument(
        "--world",
        choices=("kinematic", "mujoco"),
        default="kinematic",
        help="robots that do as they are told, or physics with mass, motors, slip and contacts, which needs"
        " formation[physics] (default: kinematic)",
    )
    group.add_argument(
        "--post", metavar="X,Y,RADIUS", type=post, action="append", default=[],
        help="with mujoco: a post that stands there [m]; repeatable; --post=-1,0,0.1 where X is below 0",
    )  # fmt: skip
    group.add_argument(
        "--wall", metavar="X,Y,X,Y", type=wall, action="append", default=[],
        help="with mujoco: a wall from here to there [m]; repeatable",
    )  # fmt: skip
    group.add_argument(
        "--picture", metavar="FILE.png", type=Path, help="with mujoco: a picture of the world at the end"
    )


def unfit(args: argparse.Namespace) -> str | None:
    """Which of these flags cannot be, and why; None if all can."""
    flag = next((flag for flag in NEEDS_MUJOCO if getattr(args, flag)), None)
    if args.world != "mujoco" and flag is not None:
        return f"--{flag}: needs --world mujoco"
    if args.picture is not None and not args.picture.absolute().parent.is_dir():
        return f"--picture {args.picture}: there is no folder {args.picture.parent}"
    if args.picture is not None and "MUJOCO_GL" not in os.environ and find_library("EGL") is None:
        return "--picture: this needs EGL, on Debian and Ubuntu: apt install libegl1"
    return None


def world_flags(args: argparse.Namespace) -> tuple[str, ...]:
    """The same flags for another process."""
    picture = () if args.picture is None else (f"--picture={args.picture}",)
    world = () if args.world == "kinematic" else ("--world", args.world)
    return (*world, *map(said, (*args.post, *args.wall)), *picture)
