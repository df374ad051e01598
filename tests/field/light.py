"""Bundles with empty packages, so that a test can install many of them."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

from formation.deploy.fleet import bundle, wheels
from formation.deploy.fleet.on_robot import VERSION

MODULES = {
    "numpy.py": "",
    "pydantic.py": "",
    "zenoh.py": "",
    "formation/__init__.py": "",
    "formation/control/laws.py": "def why_unusable(name): return None\n",
    "formation/mission/file.py": """
import tomllib, types

def load(path):
    with open(path, "rb") as file:
        robots = tomllib.load(file)["robots"]
    return types.SimpleNamespace(robots=robots, standbys={}, law=types.SimpleNamespace(kind="field"))
""",
}
MakeBundle = Callable[..., Path]
"""Makes a light bundle of robot1; each name gives another release."""
META = {
    "METADATA": "Metadata-Version: 2.1\nName: zenoh-formation\nVersion: 0.1.0\n",
    "WHEEL": "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
}


def light(whole: Path, folder: Path, modules: Mapping[str, str] | None = None, **facts: str | bool) -> Path:
    """Copy the bundle `whole`, with stand-ins for its packages; `facts` go to its VERSION.json."""
    shutil.copytree(whole, folder, ignore=shutil.ignore_patterns("*.whl", VERSION))
    (pip,) = (whole / "wheels").glob("pip-*.whl")
    wheels.link(pip, folder / "wheels" / pip.name)
    own = wheel(folder / "wheels", {**MODULES, **(modules or {})})
    pinned = f"zenoh-formation==0.1.0 --hash=sha256:{wheels.digest(own)}\n"
    (folder / "wheels" / wheels.REQUIREMENTS).write_text(pinned)
    result = json.loads((whole / VERSION).read_text())
    result |= {"release": bundle.release_id(folder), **facts}
    (folder / VERSION).write_text(json.dumps(result, indent=1) + "\n")
    return folder


def wheel(folder: Path, modules: Mapping[str, str]) -> Path:
    """Make a wheel of these modules; return its path."""
    path = folder / "zenoh_formation-0.1.0-py3-none-any.whl"
    meta = "zenoh_formation-0.1.0.dist-info"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in modules.items():
            archive.writestr(name, text)
        for name, text in META.items():
            archive.writestr(f"{meta}/{name}", text)
        named = [*modules, *(f"{meta}/{name}" for name in (*META, "RECORD"))]
        archive.writestr(f"{meta}/RECORD", "".join(f"{name},,\n" for name in named))
    return path


def release(folder: Path) -> str:
    """The release that a bundle installs."""
    named: str = json.loads((folder / VERSION).read_text())["release"]
    return named
