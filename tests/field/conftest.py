"""What the tests of this folder share: bundles are made once."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.field import deployed
from tests.field.light import Made, light


@pytest.fixture(scope="session")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bundles of `deployed.TEXT` for this machine, wheels and all; not to be changed."""
    return deployed.bundles(tmp_path_factory.mktemp("bundles"))


@pytest.fixture
def made(bundles: Path, tmp_path: Path) -> Made:
    """A maker of light bundles of robot1."""

    def make(name: str = "one", **differing: str) -> Path:
        facts = {key: value for key, value in differing.items() if key != "zenoh"}
        modules = {"zenoh.py": differing.get("zenoh", f"# {name}\n")}
        return light(bundles / "robot1", tmp_path / name, modules, **facts)

    return make
