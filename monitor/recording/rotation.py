"""Rotation of recordings: when a new file begins, its name, and the disk space to leave free."""

from __future__ import annotations

import argparse
import errno
import os
import re
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

_SIZES = {"kB": 1e3, "MB": 1e6, "GB": 1e9, "KiB": 2.0**10, "MiB": 2.0**20, "GiB": 2.0**30}
_TIMES = {"s": 1.0, "min": 60.0, "h": 3600.0}
OFF = "off"


class Rotation(NamedTuple):
    """Limits of one part; None for no limit."""

    size: float | None = 2e9
    """Largest size [bytes]. It bounds the memory of a part's index, and the loss with one broken file."""
    time: float | None = None
    """Longest duration [s]."""

    def is_due(self, size: int, age: float) -> bool:
        """Return whether a part of this `size` [bytes] and `age` [s] is to be ended."""
        return (self.size is not None and size > self.size) or (self.time is not None and age >= self.time)


class FreeSpace(NamedTuple):
    """How full a disk may become. Two limits, so that a nearly full disk does not cause many parts."""

    stop: int = 32_000_000
    """Nothing is recorded with less free space, which is left to other programs [bytes]."""
    resume: int = 128_000_000
    """Free space at which recording resumes [bytes]."""


ROTATION, FREE_SPACE = Rotation(), FreeSpace()


def of_size(text: str) -> float | None:
    """Return the value of `--rotate-size` [bytes]; None for off."""
    return _quantity(text, _SIZES, "100MB, 2GB", 1e5, "100kB")


def of_time(text: str) -> float | None:
    """Return the value of `--rotate-time` [s]; None for off."""
    return _quantity(text, _TIMES, "90s, 30min, 2h", 10.0, "10s")


def add_rotation_flags(to: argparse.ArgumentParser) -> None:
    """Add the flags for rotation: rotate_size and rotate_time."""
    group = to.add_argument_group("long recordings (NAME.mcap, NAME-2.mcap, …, each complete in itself)")
    group.add_argument(
        "--rotate-size", metavar="SIZE", type=of_size, default=ROTATION.size,
        help=f"size at which another file begins, such as 500MB, or {OFF} (default: 2GB)",
    )  # fmt: skip
    group.add_argument(
        "--rotate-time", metavar="TIME", type=of_time, default=ROTATION.time,
        help=f"time after which another file begins, such as 90s, 30min, 2h, or {OFF} (default: {OFF})",
    )  # fmt: skip


def new_path(mission: str) -> Path:
    """Return the default path of a recording that begins now; `mission` is the mission's name."""
    return Path("recordings", f"{mission}-{datetime.now().astimezone():%Y%m%d-%H%M%S}.mcap")


def part_path(first: Path, number: int) -> Path:
    """Return a part's path: part 1 is NAME.mcap, part 2 NAME-2.mcap, and so on."""
    return first if number == 1 else first.with_name(f"{first.stem}-{number}{first.suffix}")


def siblings(path: Path) -> list[Path]:
    """Return the files that by name may be parts of the same recording as `path`, itself included."""
    shorter = re.sub(r"-\d+$", "", path.stem)
    fits = re.compile(
        rf"({re.escape(path.stem)}|{re.escape(shorter)})(-\d+)?{re.escape(path.suffix)}", re.ASCII
    )
    try:
        return sorted(one for one in path.parent.iterdir() if fits.fullmatch(one.name))
    except OSError:
        return [path]


def require_free_space(folder: Path, room: int) -> None:
    """Raise OSError if there is less than `room` [bytes] on the disk of `folder`."""
    disk = os.statvfs(folder)
    if disk.f_bavail * disk.f_frsize < room:
        raise OSError(errno.ENOSPC, f"less than {room / 1e6:g} MB are left on the disk")


def _quantity(text: str, units: dict[str, float], examples: str, lowest: float, least: str) -> float | None:
    if text == OFF:
        return None
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?([A-Za-z]+)", text, re.ASCII)
    unit = {name.lower(): value for name, value in units.items()}.get(found[2].lower()) if found else None
    if found is None or unit is None:
        names = ", ".join(units)
        raise argparse.ArgumentTypeError(
            f"{text!r}: must be a number with a unit ({names}), as {examples}, or {OFF}"
        )
    value = float(found[1]) * unit
    if value < lowest:
        raise argparse.ArgumentTypeError(f"{text!r}: must be at least {least}, or {OFF}")
    return value
