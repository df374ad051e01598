"""What the tests of this folder share: bundles that are made once, and robots behind an ssh server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.field import deployed
from tests.field.bundles import Field
from tests.field.light import Made, light
from tests.field.sshd import Server, sshd


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


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """An OpenSSH server on loopback."""
    with sshd(tmp_path_factory.mktemp("sshd")) as running:
        yield running


@pytest.fixture
def field(tmp_path: Path, server: Server) -> Field:
    """Bundles, and robots behind the server that have none yet."""
    return Field(tmp_path, server)
