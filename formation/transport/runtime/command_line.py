"""Common parts of all command lines: one style of error, and how to install a missing package."""

from __future__ import annotations

import argparse
from typing import NoReturn

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


class Parser(argparse.ArgumentParser):
    """Reports invalid arguments in the common style: in one line, with exit code 2."""

    def error(self, message: str) -> NoReturn:
        """End with `message`."""
        self.exit(2, f"formation: {message.removeprefix('argument ')}; see {self.prog} --help\n")


def installing(package: str) -> str:
    """The command that installs a missing `package`; never the name of a project on a package index."""
    return f"pip install '.[{EXTRAS[package]}]' in a clone of this repository"


def needs(package: str) -> str:
    """The message that one of `EXTRAS` is missing, with the command that installs it."""
    return f"needs {package}: {installing(package)}"
