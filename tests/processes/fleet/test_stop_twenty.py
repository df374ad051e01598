"""Stops of twenty robots in real processes: all acknowledge, and who cannot is named and holds up nobody."""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest

from formation.transport import asking, wiring
from formation.transport.bus import Bus
from formation.transport.bus_config import BusConfig
from tests.processes.fleet.twenty import LEADER, Given, Team, twenty
from tests.support.child import PATIENCE

pytestmark = [pytest.mark.processes, pytest.mark.timeout(300)]
TRIES = 3
SHORT = 3.0
"""How long is waited for who will not answer [s]."""


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with twenty(tmp_path_factory.mktemp("twenty")) as team:
        yield team


def stopped(given: Given) -> set[str]:
    """Who acknowledged a stop."""
    assert {one["mode"] for one in given.report["acknowledged"]} == {"stop"}
    assert given.report["refused"] == []
    return {one["robot"] for one in given.report["acknowledged"]}


def test_all_acknowledge_every_stop_and_every_release(team: Team) -> None:
    for _ in range(TRIES):
        given = team.order("stop")
        assert (given.code, given.report["missing"], given.report["leader"]) == (0, [], LEADER), given.words
        assert stopped(given) == set(team.mission.names)
        assert given.slowest > 0.0
        assert team.order("release").code == 0


def test_release_right_after_acknowledged_stop_is_always_obeyed(
    team: Team,
) -> None:
    connect = tuple(wiring.endpoints(team.mission).agents.values())
    for do in ("stop", "release") * TRIES:
        requested = asking.addressed(team.mission, do)
        with Bus(BusConfig(connect=connect)) as bus:  # a new one, of which robots hear one after another
            given = asking.give(bus.question, requested, asking.request_for(team.mission, do), PATIENCE)
        assert given.obeyed, given.words()


def test_hanging_robot_is_named_and_all_others_stop(team: Team) -> None:
    hung = team.children["robot7"].pid
    os.kill(hung, signal.SIGSTOP)
    try:
        given = team.order("stop", seconds=SHORT)
    finally:
        os.kill(hung, signal.SIGCONT)
    assert (given.code, given.report["missing"]) == (1, ["robot7"]), given.words
    assert stopped(given) == set(team.mission.names) - {"robot7"}
    assert "robot7      NO ANSWER within 3 s" in given.words
    assert team.order("release").code == 0


@contextmanager
def black_hole() -> Iterator[str]:
    """An endpoint that takes no connection and refuses none."""
    with ExitStack() as stack:
        hole = stack.enter_context(socket.socket())
        hole.bind(("127.0.0.1", 0))
        hole.listen(0)
        for _ in range(3):  # who knocks after these is not received
            guest = stack.enter_context(socket.socket())
            guest.setblocking(False)
            with suppress(BlockingIOError):
                guest.connect(hole.getsockname())
        yield f"tcp/127.0.0.1:{hole.getsockname()[1]}"


def test_silent_address_delays_no_other(team: Team, tmp_path: Path) -> None:
    where = wiring.endpoints(team.mission).agents["robot3"]
    with black_hole() as hole:
        file = tmp_path / "moved.toml"
        file.write_text(team.file.read_text().replace(where, hole))
        given = Team(file, team.mission, team.children).order("stop", seconds=SHORT)
    assert (given.code, given.report["missing"]) == (1, ["robot3"]), given.words
    assert stopped(given) == set(team.mission.names) - {"robot3"}
    assert team.order("release").code == 0


def test_without_a_leader_all_robots_stop_and_the_leader_is_missing(team: Team) -> None:
    team.children[LEADER].signal(signal.SIGKILL)
    began = time.monotonic()
    given = team.order("stop", seconds=SHORT)
    assert time.monotonic() - began >= SHORT  # it might come back
    assert (given.code, given.report["missing"], given.report["leader"]) == (1, [LEADER], None), given.words
    assert stopped(given) == set(team.mission.followers)
    result = given.words.strip()
    assert result.endswith("no answer from leader; robots that obey stand, with a leader or without")
