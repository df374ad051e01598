"""`formation replay` as a real process: a run is recorded, then replayed to a page and to a bus."""

from __future__ import annotations

import json
import time
from collections import defaultdict
from typing import Any

import pytest

from formation.deploy.cli import main
from formation.monitor.metrics.keys import OWN
from formation.monitor.recording.reader import Recorded, read
from formation.transport.bus import Bus, BusConfig
from formation.wire import Sample
from tests.processes.monitor.replayed import Replayed, Run, replaying
from tests.support.child import PATIENCE, free_endpoint, until

pytestmark = pytest.mark.processes
Payloads = list[tuple[bytes, bytes | None]]
ROUNDED = 0.0006
"""Bound of the rounding error of the time in a frame [s]."""
SOON = 0.001
"""Longest time from the last message of a frame to the time at which it is compared [s]."""


@pytest.fixture(scope="module")
def messages(run_of_six: Run) -> list[Recorded]:
    return list(read(run_of_six.path).messages())


def by_key(samples: list[Sample]) -> dict[str, Payloads]:
    found: dict[str, Payloads] = defaultdict(list)
    for sample in samples:
        found[sample.key].append((sample.payload, sample.attachment))
    return dict(found)


def wait_for_link(bus: Bus, replay: Replayed) -> None:
    """Play until something is received, so that nothing is missed later; then pause at the start."""
    replay.steered("play")
    until(lambda: bool(bus.received))
    replay.steered("pause")
    replay.steered("seek", 0.0)
    quiet = time.monotonic()
    while bus.wait(0.5):  # discard messages in transit
        bus.drain()
        assert time.monotonic() < quiet + 10.0


def test_replay_publishes_every_message_exactly_with_attachment(
    run_of_six: Run, messages: list[Recorded]
) -> None:
    end = free_endpoint()
    with (
        replaying(run_of_six.path, "--paused", "-l", end) as replay,
        Bus(BusConfig(connect=(end,)), capacity=100_000) as bus,
    ):
        bus.subscribe("**")
        wait_for_link(bus, replay)
        start, before = time.monotonic(), bus.received.total()
        replay.steered("play")
        result = replay.result(PATIENCE + messages[-1].wall - messages[0].wall)
        took = time.monotonic() - start
        until(lambda: bus.received.total() - before >= len(messages))  # some may still be in transit
        received = bus.drain()
    assert {sample.key.partition("/")[0] for sample in received} == {"replay"}
    played = by_key([one.sample for one in messages])
    came = by_key([one._replace(key=one.key.removeprefix("replay/")) for one in received])
    assert {key: len(output) for key, output in came.items()} == {
        key: len(output) for key, output in played.items()
    }
    assert came == played
    assert any(attachment for _, attachment in played["robot1/position"])
    assert took > messages[-1].wall - messages[0].wall - 0.1
    assert (result["finished"], result["skipped"]) == (True, 0)
    assert replay.process.returncode == 0


def comparable_frames(run: Run, messages: list[Recorded]) -> list[tuple[float, dict[str, Any]]]:
    """Return live frames with a known error, each with a time until which exactly its messages are played.

    In a recording, the messages of a frame come before the monitor's own messages of that time.
    """
    own, found = {one.key for one in OWN}, []
    output = [(number, one.wall) for number, one in enumerate(messages, 1) if one.sample.key in own]
    for frame in run.frames:
        until = max((number for number, wall in output if abs(wall - frame["t"]) < ROUNDED), default=0)
        last = max((one.wall for one in messages[:until]), default=0.0)
        following = min((one.wall for one in messages[until:]), default=0.0)
        if frame["error"] is not None and last < following:
            found.append((min(following, last + SOON), frame))
    return found


def test_replay_page_equals_live_page_of_that_time(run_of_six: Run, messages: list[Recorded]) -> None:
    comparable = comparable_frames(run_of_six, messages)
    assert len(comparable) >= 20
    assert max(live["error"] for _, live in comparable) > 1.0  # it moves
    chosen = comparable[:: len(comparable) // 10]
    with replaying(run_of_six.path, "--paused", "-l", free_endpoint()) as replay:
        for at, live in [*chosen, *reversed(chosen)]:  # forwards and backwards
            hello, frame = replay.picture(at)
            assert frame["replay"]["paused"]
            assert frame["replay"]["t"] == frame["t"]
            for name in ("mode", "shape", "converged", "missed", "rejected"):
                assert frame[name] == live[name], name
            for name in ("error", "true", "elapsed", "settled_at", "e"):
                assert frame[name] == pytest.approx(live[name], abs=0.0021), name
            for shown, was in zip(frame["r"], live["r"], strict=True):
                for field, a, b in zip(hello["fields"], shown, was, strict=True):
                    expected = b if b is None or isinstance(b, str) else pytest.approx(b, abs=0.0021)
                    if field not in {"rate", "health", "health_why", "reason"}:
                        assert a == expected, (field, live["t"])
        assert (hello["live"], hello["control"], hello["mission"]) == (
            False,
            False,
            run_of_six.hello["mission"],
        )
        assert hello["recording"] == str(run_of_six.path)
        assert replay.interrupt()["interrupted"]
    assert replay.process.returncode == 130


def test_replay_result_equals_result_of_run(run_of_six: Run, capsys: pytest.CaptureFixture[str]) -> None:
    flags = ("--no-page", "--no-zenoh", "--speed", "100", "--json")
    assert main(["replay", str(run_of_six.path), *flags]) == 0
    result, live = json.loads(capsys.readouterr().out.splitlines()[-1]), run_of_six.result
    assert result["converged"] == live["converged"]
    assert result["formation_error"] == pytest.approx(live["formation_error"], abs=1e-9)
    assert result["settling_time"] == pytest.approx(live["settling_time"], abs=1e-5)
    assert result["played"] == live["recorded"]
