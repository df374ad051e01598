"""Rehearsals and simulations on a Dask cluster: a scheduler and two workers as processes."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.refusal import Refusal
from formation.deploy.rehearsal.workers import each
from tests.support.child import PATIENCE, free_endpoint

pytestmark = pytest.mark.processes
pytest.importorskip("distributed", reason="needs distributed (the extra dask)")


@contextmanager
def process(*words: str, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    with subprocess.Popen(
        [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]],
        cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    ) as child:  # fmt: skip
        try:
            yield child
        finally:
            child.kill()


def worker(address: str, folder: Path) -> Any:
    quiet = ("--no-dashboard", "--nthreads", "1", "--no-nanny", "--local-directory", str(folder))
    return process("dask_worker", address, *quiet, folder=folder)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """The scheduler's address, and two workers."""
    folder = tmp_path_factory.mktemp("dask")
    # not a port that a connection may get before the scheduler listens
    port = free_endpoint().rpartition(":")[2]
    address = f"tcp://127.0.0.1:{port}"
    with ExitStack() as stack:
        flags = ("--host", "127.0.0.1", "--port", port, "--no-dashboard")
        stack.enter_context(process("dask_scheduler", *flags, folder=folder))
        workers = [stack.enter_context(worker(address, folder)) for _ in range(2)]
        _wait_for_workers(address, 2)
        yield address, workers


def _wait_for_workers(address: str, count: int) -> None:
    from distributed import Client

    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            with Client(address, timeout=2.0, set_as_default=False) as client:  # type: ignore[no-untyped-call]
                client.wait_for_workers(count, timeout=PATIENCE)
                return
        except OSError:
            assert time.monotonic() < deadline


def json_output(*words: str) -> dict[str, Any]:
    """JSON output of the command without its timing."""
    done = subprocess.run(
        [sys.executable, "-m", "formation.deploy", *words, "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return {
        name: value for name, value in found.items() if name not in {"wall_time", "robot_steps_per_second"}
    }


def test_rehearsals_with_dask_equal_those_without(cluster: tuple[str, Any]) -> None:
    words = ("rehearse", "turtlebot3_pair", "--seeds", "3")
    assert json_output(*words, "--dask", cluster[0]) == json_output(*words)


def test_simulations_with_dask_equal_those_without(cluster: tuple[str, Any]) -> None:
    words = ("simulate", "turtlebot3_pair", "--runs", "501", "--horizon", "2", "--noise", "0.001")
    assert json_output(*words, "--dask", cluster[0]) == json_output(*words)


def test_lost_worker_loses_no_result(cluster: tuple[str, list[subprocess.Popen[bytes]]]) -> None:
    def power(number: int) -> int:  # a local function, so that Dask sends its code
        import time

        time.sleep(0.1)
        return int(2**number)

    address, workers = cluster
    results = each(power, range(30), dask=address)
    assert next(results) == 1
    workers[0].kill()
    assert [1, *results] == [2**number for number in range(30)]


def test_missing_scheduler_is_refused_with_its_address(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.deploy.rehearsal.workers.CONNECT_TIMEOUT_SECONDS", 1.0)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
        with pytest.raises(Refusal, match=f"--dask {address}: no scheduler answers"):
            next(each(abs, [1], dask=address))
