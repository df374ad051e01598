"""Foxglove as flags ask for it: a server, or a layout file. The SDK is imported only for the server."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from formation.mission import Mission
from monitor.figures.keys import Watched
from monitor.outlets import layout
from monitor.page.address import Bind

if TYPE_CHECKING:
    from monitor.outlets.foxglove import Foxglove

HOST, PORT = "127.0.0.1", 8765
"""Where Foxglove looks for a server by itself."""
READ_ONLY = """\
Open the address in Foxglove. It tells and takes nothing: nobody moves a robot through it. But whoever can
reach the address sees everything, unencrypted; by default that is this machine alone.
"""


class OutletError(ValueError):
    """What was asked for cannot be had; the text names the flag and says why."""


def add_foxglove_flags(flags: argparse.ArgumentParser) -> None:
    """Add ``--foxglove`` and ``--foxglove-layout``."""
    group = flags.add_argument_group("Foxglove, live (extra: foxglove)", READ_ONLY)
    group.add_argument(
        "--foxglove", metavar="HOST:PORT", nargs="?", type=_bind, const=Bind(HOST, PORT),
        help=f"serve every topic to it (default: {HOST}:{PORT})",
    )  # fmt: skip
    group.add_argument(
        "--foxglove-layout", metavar="FILE", type=Path, help="write a layout for the mission, and end"
    )


def served(bind: Bind, mission: Mission, keys: Iterable[Watched]) -> Foxglove:
    """A server that tells of `keys`. Raises OutletError."""
    try:
        from monitor.outlets.foxglove import Foxglove  # noqa: PLC0415 - an extra, which few need
    except ModuleNotFoundError as missing:
        text = f"--foxglove needs {missing.name}: pip install 'formation[foxglove]'"
        raise OutletError(text) from None
    try:
        return Foxglove(bind.host, bind.port, f"formation: {mission.name}", keys)
    except OSError as error:
        raise OutletError(f"--foxglove {bind.host}:{bind.port}: {error}") from None


def write_layout(path: Path, mission: Mission) -> None:
    """Write a layout file, which must not exist. Raises OutletError."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(layout.text(mission))
    except FileExistsError:
        raise OutletError(f"--foxglove-layout {path}: exists already") from None
    except OSError as error:
        raise OutletError(f"--foxglove-layout {path}: cannot be written: {error.strerror}") from None


def _bind(text: str) -> Bind:
    try:
        return Bind.of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).replace(":8460", f":{PORT}")) from None
