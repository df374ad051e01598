"""Files of an agent: complete at every moment, and written without blocking the agent."""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from formation.agent.persistence import store
from formation.agent.persistence.store import Store, Worker, boot_id
from tests.support.child import until


@pytest.fixture
def files(tmp_path: Path) -> Iterator[Store]:
    with closing(Store(tmp_path / "made" / "state", "robot2")) as one:
        yield one


def test_new_store_reads_none(files: Store) -> None:
    assert files.read_stops() is None
    assert files.read_state() is None


def test_next_store_reads_stops_and_state(files: Store) -> None:
    files.write_stops({"mode": "stop"})
    files.write_state({"long": "x" * 500})
    files.write_state({"mono": 1.5})
    files.close()
    with closing(Store(files.stops.parent, "robot2")) as after:
        assert json.loads(after.read_stops() or b"") == {"mode": "stop"}
        assert json.loads(after.read_state() or b"") == {"mono": 1.5}
        assert after.failure == ""


def test_two_robots_in_one_folder_have_separate_files(files: Store) -> None:
    with closing(Store(files.stops.parent, "robot3")) as other:
        other.write_stops({"mode": "stop"})
        other.write_state({"mono": 1.5})
    assert files.read_stops() is None
    assert files.read_state() is None


def test_newest_stops_and_state_are_stored_at_close(files: Store) -> None:
    for number in range(300):
        files.write_stops({"number": number})
        files.write_state({"number": number})
    files.close()
    assert json.loads(files.read_stops() or b"") == {"number": 299}
    assert json.loads(files.read_state() or b"") == {"number": 299}


def test_stops_file_is_always_whole(files: Store) -> None:
    found = []
    for number in range(500):
        files.write_stops({"number": number, "answers": {str(i): "x" * 100 for i in range(64)}})
        if (text := files.read_stops()) is not None:
            found.append(json.loads(text)["number"])
    files.close()
    found.append(json.loads(files.read_stops() or b"")["number"])
    assert found == sorted(found)
    assert found[-1] == 499


@pytest.mark.parametrize("torn", [b"", b"\n", b"12345678", b"12345678 {}\n"])
def test_incomplete_state_file_raises_os_error(files: Store, torn: bytes) -> None:
    files.state.write_bytes(torn)
    with pytest.raises(OSError, match="was not written to its end"):
        files.read_state()


def test_state_set_aside_is_not_read_again(files: Store) -> None:
    files.write_state({"mono": 1.5})
    aside = files.set_state_aside()
    files.write_state({"mono": 2.0})  # too late
    assert aside is not None
    assert b"1.5" in aside.read_bytes()
    assert files.read_state() is None


def test_reading_pipe_raises_os_error(files: Store) -> None:
    os.mkfifo(files.stops)
    with pytest.raises(OSError, match="must be a file"):
        files.read_stops()


def test_reader_stops_at_max_file_bytes(files: Store) -> None:
    files.stops.write_bytes(b" " * (store.MAX_FILE_BYTES + 1))
    with pytest.raises(OSError, match="is longer than anything that an agent keeps"):
        files.read_stops()


class Hanging:
    """A disk on which `calls` block until `go_on` is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *calls: str) -> None:
        self.go_on, self.requested = threading.Event(), 0
        for call in calls:
            monkeypatch.setattr(os, call, self._hang(getattr(os, call)))

    def _hang(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            self.requested += 1
            assert self.go_on.wait(30.0)
            return real(*arguments)

        return call


def test_hanging_disk_delays_neither_stop_nor_next_stop(
    files: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Hanging(monkeypatch, "fsync", "pwrite")
    began = time.monotonic()
    files.write_state({"mono": 1.0})
    files.write_stops({"number": 1})
    until(lambda: disk.requested == 2)
    files.write_stops({"number": 2})  # while the first is being forced to the disk
    until(lambda: b"2" in (files.read_stops() or b""))
    for _ in range(100):
        files.write_state({"mono": 2.0})
    assert time.monotonic() - began < 10.0
    disk.go_on.set()


def test_close_does_not_wait_forever_for_hanging_disk(files: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = Hanging(monkeypatch, "fsync")
    monkeypatch.setattr(store, "CLOSE_TIMEOUT_SECONDS", 0.05)
    files.write_stops({"number": 1})
    until(lambda: disk.requested)
    files.close()
    assert files.read_stops() is not None
    disk.go_on.set()


def test_failure_is_reported_until_write_succeeds(files: Store) -> None:
    files.stops.mkdir()
    files.write_stops({"mode": "stop"})
    assert not files.written(30.0), "a failed write is reported as written"
    until(lambda: files.failure)
    assert "directory" in files.failure
    files.stops.rmdir()
    files.write_stops({"mode": "stop"})
    assert files.written(30.0)
    until(lambda: not files.failure)


def test_worker_runs_newest_job_and_skips_replaced_ones() -> None:
    worker, done, go_on = Worker("test"), list[int](), threading.Event()
    worker.do(lambda: done.append(0 if go_on.wait(30.0) else -1))
    for number in range(1, 50):
        worker.do(lambda number=number: done.append(number))  # type: ignore[misc]
    go_on.set()
    assert worker.close(30.0)
    assert done[-1] == 49
    assert len(done) <= 3


def test_boot_id_is_constant_and_not_empty() -> None:
    assert boot_id() == boot_id() != ""
