"""Fixtures of this folder: bundles that are made once, and robots behind an ssh server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from formation.deploy.fleet import wheels
from formation.deploy.fleet.wheels import Target
from tests.field import deployed
from tests.field.bundles import Field
from tests.field.light import MakeBundle, light
from tests.field.sshd import Server, sshd


@pytest.fixture(scope="session")
def bundles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bundles of `deployed.TEXT` for this machine, with all wheels; do not change them."""
    return deployed.bundles(tmp_path_factory.mktemp("bundles"))


@pytest.fixture(scope="session")
def installed(bundles: Path, tmp_path_factory: pytest.TempPathFactory) -> deployed.Installed:
    """Whole installations of `bundles`; do not change them."""
    return deployed.Installed(bundles, tmp_path_factory.mktemp("installed"))


@pytest.fixture
def make_bundle(bundles: Path, tmp_path: Path) -> MakeBundle:
    """Function that makes light bundles of robot1."""

    def make(name: str = "one", **differing: str) -> Path:
        facts = {key: value for key, value in differing.items() if key != "zenoh"}
        modules = {"zenoh.py": differing.get("zenoh", f"# {name}\n")}
        return light(bundles / "robot1", tmp_path / name, modules, **facts)

    return make


@pytest.fixture
def no_wheels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Collect two files instead of wheels; `test_wheels` and `test_install` use real ones."""

    def collect(target: Target, folder: Path, before: object = (), *, fetch: bool = True) -> None:
        del before
        (folder / "zenoh_formation-0.1.0-py3-none-any.whl").write_text(f"{target}{fetch}")
        (folder / wheels.REQUIREMENTS).write_text("zenoh-formation==0.1.0\n")

    monkeypatch.setattr(wheels, "collect", collect)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """An OpenSSH server on loopback."""
    with sshd(tmp_path_factory.mktemp("sshd")) as running:
        yield running


@pytest.fixture
def field(tmp_path: Path, server: Server) -> Field:
    """Bundles, and robots behind the server without an installation."""
    return Field(tmp_path, server)
