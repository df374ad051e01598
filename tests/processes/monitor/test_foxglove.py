"""`formation monitor --foxglove` as a real process, with a Foxglove client."""

from __future__ import annotations

import signal
import socket
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.exceptions import ConnectionClosed

from formation.deploy.cli import main
from formation.monitor.metrics.keys import OWN
from formation.topics import DIAGNOSTICS
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.command_line import needs
from tests.processes.agent.actor import KEYS, Actor, recorded, router
from tests.support.child import PATIENCE, free_endpoint, started
from tests.support.foxglove_viewer import Message, Viewer, viewing

pytestmark = pytest.mark.processes
ALL = {f"/{one.key}" for one in (*KEYS, *OWN)}
METRICS = {f"/{one.key}" for one in OWN}
PUBLISHED = {topic for topic in ALL if not topic.endswith("/scan")}


def until_closed(viewer: Viewer) -> Iterator[Message]:
    try:
        while True:
            yield viewer.receive()
    except ConnectionClosed:
        return


def test_foxglove_client_gets_recorded_messages_exactly(tmp_path: Path) -> None:
    path, end, stage_end = tmp_path / "run.mcap", free_endpoint(), free_endpoint()
    flags = ("-e", end, "--stage", stage_end, "--record", str(path), "--no-page", "--foxglove", "127.0.0.1:0")
    with (
        Bus(BusConfig(listen=(end,))) as bus,
        router(stage_end) as stage,
        started("formation.monitor", "six_robots", *flags) as child,
    ):
        ready = child.event("ready")
        actor = Actor(bus, stage)
        actor.wait_for_monitor()
        with viewing(ready["foxglove"], max_queue=None) as viewer:
            viewer.advertised(len(ALL))
            viewer.subscribe(*ALL)
            while viewer.receive().topic != f"/{DIAGNOSTICS.key()}":  # then the server has the subscriptions
                pass
            actor.play(2.0)
            reported: list[Message] = []
            missing = Counter({f"/{key}": count for key, count in actor.published.items()})
            while +missing:  # a server that stops closes the connection at once
                reported.append(viewer.receive())
                missing[reported[-1].topic] -= 1
            assert child.signal(signal.SIGTERM) < PATIENCE
            reported += until_closed(viewer)
            assert child.wait() == 0
            assert "foxglove: ws://127.0.0.1:" in child.errors
    in_file = recorded(path)
    for topic in PUBLISHED:
        payloads = [one.payload for one in reported if one.topic == topic]
        assert payloads
        kept = in_file[topic.removeprefix("/")]
        assert payloads == (kept[-len(payloads) :] if topic in METRICS else kept), topic
    for one in reported:
        channel = viewer.channels[one.topic]
        schema = Schema(1, channel["schema"].encode(), "ros2msg", channel["schemaName"])
        decoder = DecoderFactory().decoder_for("cdr", schema)
        assert decoder is not None
        decoder(one.payload)


def test_foxglove_port_in_use_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        where = f"127.0.0.1:{holder.getsockname()[1]}"
        flags = ("--no-record", "--no-page", "--no-stage", "--foxglove", where)
        assert monitor(capsys, "-l", free_endpoint(), *flags) == (
            2, f"monitor: --foxglove {where}: address already in use\n",
        )  # fmt: skip


@pytest.fixture
def without_foxglove(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have no package foxglove on this machine."""
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "formation.monitor.exporters.foxglove", raising=False)


def monitor(capsys: pytest.CaptureFixture[str], *flags: str) -> tuple[int, str]:
    """Return the exit code of `formation monitor`, and what it prints on stderr."""
    code = main(["monitor", "six_robots", *flags])
    return code, capsys.readouterr().err


@pytest.mark.usefixtures("without_foxglove")
def test_missing_foxglove_sdk_prints_what_to_install(capsys: pytest.CaptureFixture[str]) -> None:
    flags = ("--foxglove", "-l", free_endpoint(), "--no-record", "--no-page")
    assert monitor(capsys, *flags) == (2, f"monitor: --foxglove {needs('foxglove')}\n")


@pytest.mark.usefixtures("without_foxglove")
def test_layout_is_written_without_sdk_or_overwriting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, new = tmp_path / "layout.json", tmp_path / "new" / "layout.json"
    assert monitor(capsys, "--foxglove-layout", str(path)) == (0, "")
    written = path.read_text(encoding="utf-8")
    assert written.startswith('{\n  "configById"')
    again = monitor(capsys, "--foxglove-layout", str(path))
    assert again == (2, f"monitor: --foxglove-layout {path}: exists already; name a new file\n")
    assert path.read_text(encoding="utf-8") == written
    below = monitor(capsys, "--foxglove-layout", str(path / "layout.json"))
    why = "cannot be written: File exists"
    assert below == (2, f"monitor: --foxglove-layout {path}/layout.json: {why}\n")
    assert monitor(capsys, "--foxglove-layout", str(new)) == (0, "")
    assert new.is_file()
