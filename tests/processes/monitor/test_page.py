"""The live page of a real monitor that watches a fleet over real Zenoh."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from prometheus_client import Metric
from prometheus_client.parser import text_string_to_metric_families

from formation.monitor.__main__ import main
from formation.monitor.web.address import IN_USE, Bind, listening
from formation.transport.bus import Bus, BusConfig
from tests.processes.agent.actor import Actor, router
from tests.support.child import PATIENCE, Child, free_endpoint, started, until
from tests.support.looking import PLAIN, looking

pytestmark = pytest.mark.processes


@contextmanager
def monitor_with_page(*flags: str) -> Iterator[tuple[Child, Actor, str]]:
    """Start a monitor with a page; yield it, the fleet that it watches and the page's address."""
    end, stage_end = free_endpoint(), free_endpoint()
    links = ("-e", end, "--stage", stage_end)
    with (
        Bus(BusConfig(listen=(end,))) as bus,
        router(stage_end) as stage,
        started("formation.monitor", "six_robots", *links, "--page", "127.0.0.1:0", *flags) as child,
    ):
        page = child.event("ready")["page"]
        actor = Actor(bus, stage)
        actor.wait_for_monitor()
        yield child, actor, page


@contextmanager
def playing(actor: Actor) -> Iterator[None]:
    """Play the fleet in a thread meanwhile."""
    over = threading.Event()

    def play() -> None:
        while not over.is_set():
            actor.play(0.2)

    thread = threading.Thread(target=play)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def requested(page: str, path: str) -> httpx.Response:
    return httpx.get(page + path, timeout=PATIENCE, verify=PLAIN)


def requested_with_frame(page: str, path: str) -> httpx.Response:
    """Return an answer that needs a new frame, asked for again while there was none for a second."""
    answers: list[httpx.Response] = []

    def given() -> bool:
        answers.append(requested(page, path))
        return answers[-1].status_code != 503

    until(given)
    return answers[-1]


def metrics_with_known_error(page: str) -> dict[str, Metric]:
    """Return the metrics for Prometheus once the error is known: not while a position is late."""
    families: dict[str, Metric] = {}

    def known() -> bool:
        answer = requested_with_frame(page, "metrics")
        families.update({one.name: one for one in text_string_to_metric_families(answer.text)})
        return bool(families["formation_error_meters"].samples)

    until(known)
    return families


def rows(hello: dict[str, Any], frame: dict[str, Any]) -> dict[str, dict[str, Any]]:
    names = [robot["name"] for robot in hello["robots"]]
    return {
        name: dict(zip(hello["fields"], row, strict=True))
        for name, row in zip(names, frame["r"], strict=True)
    }


def test_page_serves_frames_metrics_snapshot_and_health(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with monitor_with_page("--record", str(path)) as (child, actor, page), playing(actor):
        with looking(page) as events:
            hello = next(events)
            assert (hello.kind, hello.data["live"], hello.data["control"]) == ("hello", True, False)
            assert hello.data["recording"] == str(path)
            frames = (event.data for event in events if event.kind == "frame")
            known = (frame for frame in frames if frame["error"] is not None)  # no position was late
            first = next(known)
            later = next(frame for frame in known if frame["t"] > first["t"] + 1.0)
        assert later["error"] < 0.001
        for name, row in rows(hello.data, later).items():
            assert row["state"] == "run"
            moved = complex(row["x"], row["y"]) - complex(*first["r"][hello_index(hello.data, name)][:2])
            assert abs(moved) == pytest.approx(0.2 * (later["t"] - first["t"]), abs=0.12)  # at 0.2 m/s
        assert later["recording"]["path"] == str(path)
        families = metrics_with_known_error(page)
        assert families["formation_error_meters"].samples[0].value < 0.001
        assert len(families["formation_robot_state"].samples) == 6
        snapshot = requested_with_frame(page, "api/snapshot").json()
        assert snapshot["robots"]["robot2"]["state"] == "run"
        assert requested(page, "healthz").text == "ok\n"
        assert child.signal(signal.SIGTERM) < PATIENCE
    assert child.wait() == 0


def hello_index(hello: dict[str, Any], name: str) -> int:
    return [robot["name"] for robot in hello["robots"]].index(name)


def test_control_page_needs_token_and_ends_within_10_s_while_open() -> None:
    with monitor_with_page("--no-record", "--control") as (child, _, invitation):
        page, _, token = invitation.partition("#token=")
        assert len(token) >= 32
        refused = httpx.post(page + "api/order", json={"do": "stop"}, timeout=PATIENCE, verify=PLAIN)
        assert refused.status_code == 401
        with looking(page) as one, looking(page) as other:
            assert [next(one).data["control"], next(other).data["control"]] == [True, True]
            assert child.signal(signal.SIGTERM) < 10.0
            assert child.wait() == 0
        summary = list(iter(child._lines.get, None))[-1]
        assert summary is not None
        assert '"event": "summary"' in summary
        assert "Traceback" not in child.errors
        assert f"page: {page}; to give orders, the one in the ready line\n" in child.errors
        assert token not in child.errors


def test_page_port_in_use_is_refused_only_if_requested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    links = ("six_robots", "--no-stage", "-l")
    with listening(Bind(port=0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main([*links, free_endpoint(), "--record", str(tmp_path / "run.mcap"), "--page", where]) == 2
        refused = f"monitor: --page {where}: Address already in use: {IN_USE}\n"
        assert capsys.readouterr().err == refused
    assert not list(tmp_path.iterdir())
    pages = set()
    with (
        started("formation.monitor", *links, free_endpoint(), "--no-record") as one,
        started("formation.monitor", *links, free_endpoint(), "--no-record") as other,
    ):
        for child in (one, other):
            page = child.event("ready")["page"]
            assert requested(page, "healthz").status_code == 200
            pages.add(page)
        for child in (one, other):
            child.signal(signal.SIGTERM)
            assert child.wait() == 0
    assert len(pages) == 2
