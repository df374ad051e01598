"""`formation run`: what it refuses before any process starts."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from formation.deploy.local import run
from formation.monitor.web.address import NOT_HERE
from tests.unit.deploy.commands import Capsys, refused


@pytest.fixture(autouse=True)
def no_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in an empty folder, and fail if a process is about to start."""

    def start(*_: object) -> None:
        pytest.fail("a process starts")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run, "start", start)


def test_page_address_of_another_machine_is_refused(tmp_path: Path, capsys: Capsys) -> None:
    err = refused(capsys, ["run", "--page", "192.0.2.1:8460"])
    assert err == f"formation: --page 192.0.2.1:8460: Cannot assign requested address: {NOT_HERE}\n"
    assert not list(tmp_path.iterdir())


def test_page_port_in_use_is_refused(capsys: Capsys) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        assert refused(capsys, ["run", "--page", where]) == (
            f"formation: --page {where}: Address already in use\n"
        )
