"""The command-line flags that choose the world of simulated robots."""

from __future__ import annotations

import argparse
import os
from ctypes.util import find_library
from pathlib import Path

from formation.agent.simulated import faults
from formation.mission.model import Mission
from formation.transport.runtime.command_line import make_folder

NEEDED = ("mujoco", "PIL")
"""Packages of the physics world."""
PNG = b"\x89PNG\r\n\x1a\n"
"""First bytes of every PNG file."""


def add_world_flags(to: argparse.ArgumentParser) -> None:
    """Add the flags for the world of the robots, and for a picture of it."""
    group = to.add_argument_group("the world of the simulated robots")
    group.add_argument(
        "--world",
        choices=("kinematic", "mujoco"),
        default="kinematic",
        help="robots that move as commanded, or physics with mass, motors, slip and contacts, which needs"
        " the extra physics (default: kinematic)",
    )
    group.add_argument(
        "--fault",
        metavar="FAULT",
        action="append",
        default=[],
        help=f"a fault to simulate, {faults.FORM}; KIND is one of {', '.join(faults.SIZES)}; repeatable",
    )
    group.add_argument(
        "--picture", metavar="FILE.png", type=Path, help="with mujoco: a picture of the world at the end"
    )


def unfit(args: argparse.Namespace, mission: Mission) -> str | None:
    """Which of these flags are invalid for `mission`, and why; None if none."""
    if wrong := _unfit_faults(args, mission):
        return wrong
    if args.picture is None:
        return None
    if args.world != "mujoco":
        return "--picture: needs --world mujoco"
    try:
        wrong = _no_place(args.picture)
    except OSError as error:
        wrong = error.strerror
    if wrong is not None:
        return f"--picture {args.picture}: {wrong}"
    if "MUJOCO_GL" not in os.environ and find_library("EGL") is None:
        return "--picture: needs EGL to render; on Debian and Ubuntu: apt install libegl1"
    return None


def _unfit_faults(args: argparse.Namespace, mission: Mission) -> str | None:
    """Which of the faults are invalid, and why."""
    if args.fault and args.world != "kinematic":
        return "--fault: needs --world kinematic"
    for text in args.fault:
        try:
            robot = faults.parse(text, mission).robot
        except ValueError as wrong:
            return f"--fault {wrong}"
        if robot not in mission.followers:
            return f"--fault {text!r}: {robot}: must be one of {', '.join(mission.followers)}"
    return None


def _no_place(picture: Path) -> str | None:
    """Make the folder of a picture; why none can be written there, None if one can. Raises OSError."""
    if picture.suffix.lower() != ".png":
        return "must end in .png"
    make_folder(picture.parent)
    if picture.is_dir():
        return "is a folder; name a file"
    if not picture.exists():
        return None
    # a new picture may replace an old one, and no other file
    if not picture.is_file() or _begin(picture) not in {PNG, b""}:
        return "is there already, and is no picture; name another file"
    return None if os.access(picture, os.W_OK) else "cannot be written to"


def _begin(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(len(PNG))


def world_flags(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the same flags for another process."""
    world = () if args.world == "kinematic" else ("--world", args.world)
    rehearsed = [word for text in args.fault for word in ("--fault", text)]
    picture = () if args.picture is None else ("--picture", str(args.picture))
    return (*world, *picture, *rehearsed)
