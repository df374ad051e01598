"""The environment of the peers: a folder of their own, so that nothing of theirs comes near this project's.

It is not in the lock: a developer or a robot never needs it, and its pins would hold back the project's own.
"""

from __future__ import annotations

import subprocess
import tomllib
import venv
from pathlib import Path

GROUP = "bench"
"""The dependency group in pyproject.toml that names them."""


def interpreter(folder: Path) -> Path:
    """The Python of the peers' environment in `folder`, which is made or completed where need be."""
    python = folder.absolute() / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
    install = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*install, *requirements()], check=True)
    return python


def requirements() -> list[str]:
    """What pyproject.toml asks for on the peers' behalf."""
    pyproject = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))
    return [str(requirement) for requirement in pyproject["dependency-groups"][GROUP]]
