"""Foxglove as requested by flags: a server, or a layout file. The SDK is imported only for the server."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from formation.mission.model import Mission
from formation.monitor.exporters import layout
from formation.monitor.metrics.keys import Watched
from formation.monitor.web.address import Bind
from formation.transport.runtime.command_line import needs

if TYPE_CHECKING:
    from formation.monitor.exporters.foxglove import Foxglove

HOST, PORT = "127.0.0.1", 8765
"""Foxglove's default address of a server."""
READ_ONLY = """\
Open the address in Foxglove. It only shows: it takes no orders. But any program that can
reach the address sees everything, unencrypted; by default that is this machine alone.
"""


class ExporterError(ValueError):
    """A request cannot be met; the text names the flag and the cause."""


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
    """Return a server that sends `keys`. Raises OutletError."""
    try:
        from formation.monitor.exporters.foxglove import Foxglove  # noqa: PLC0415 - an optional extra
    except ModuleNotFoundError:
        text = f"--foxglove {needs('foxglove')}"
        raise ExporterError(text) from None
    try:
        return Foxglove(bind.host, bind.port, f"formation: {mission.name}", keys)
    except OSError as error:
        raise ExporterError(f"--foxglove {bind.host}:{bind.port}: {error}") from None


def write_layout(path: Path, mission: Mission) -> None:
    """Write a layout file, which must not exist. Raises OutletError."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(layout.text(mission))
    except FileExistsError:
        raise ExporterError(f"--foxglove-layout {path}: exists already") from None
    except OSError as error:
        raise ExporterError(f"--foxglove-layout {path}: cannot be written: {error.strerror}") from None


def _bind(text: str) -> Bind:
    try:
        return Bind.of(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error).replace(":8460", f":{PORT}")) from None
