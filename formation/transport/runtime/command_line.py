"""Common parts of all command lines: one style of error, and how to install a missing package."""

from __future__ import annotations

import argparse
import errno
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

EXTRAS = {
    **dict.fromkeys(
        ("rich", "mcap", "lz4", "zstandard", "starlette", "uvicorn", "prometheus_client"), "monitor"
    ),
    **dict.fromkeys(("matplotlib", "jinja2", "markupsafe"), "plot"),
    "cryptography": "field",
    "foxglove": "foxglove",
    "numba": "simulate",
    "distributed": "dask",
    "tomlkit": "assign",
    **dict.fromkeys(("mujoco", "PIL"), "physics"),
}
"""The extra in pyproject.toml that installs a package which robots do not need."""


class Once(argparse.Action):
    """Stores the value of a flag, which is given at most once: of two values one would have no effect."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        """Refuse a second value."""
        if option_string is not None and isinstance(parser, Parser):
            if self in parser.given:
                raise argparse.ArgumentError(self, "is given twice, and takes one value")
            parser.given.add(self)
        setattr(namespace, self.dest, values)


class Parser(argparse.ArgumentParser):
    """Reports invalid arguments in the common style: in one line, with exit code 2."""

    def __init__(self, prog: str, what: str, examples: str, usage: str | None = None) -> None:
        """`what` the command does, and its `examples`, are printed unchanged in its help."""
        super().__init__(
            prog=prog,
            usage=usage,
            description=what,
            epilog=f"examples:\n{examples}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        self.given: set[argparse.Action] = set()
        """Flags with one value that have been read."""
        for name in (None, "store"):
            self.register("action", name, Once)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Begin with no flag given."""
        self.given.clear()
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """End with `message`."""
        self.exit(2, f"formation: {message.removeprefix('argument ')}; see {self.prog} --help\n")


def make_folder(folder: Path) -> None:
    """Make a folder to write to, as every command does before its work, so that it fails early.

    Raises OSError, also if it cannot be written to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if not os.access(folder, os.W_OK):
        raise OSError(errno.EACCES, "the folder cannot be written to", str(folder))


def installing(package: str) -> str:
    """The command that installs a missing `package`; never the name of a project on a package index."""
    return f"pip install '.[{EXTRAS[package]}]' in a clone of this repository"


def needs(package: str) -> str:
    """The message that one of `EXTRAS` is missing, with the command that installs it."""
    return f"needs {package}: {installing(package)}"
