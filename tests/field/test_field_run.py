"""Installed bundles in a field: each robot on a computer of its own, with mTLS and access control."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from formation.topics import CMD_VEL, ODOM, POSITION, STATUS
from formation.transport.wiring import partners
from tests.field.deployed import Deployed, Installed
from tests.support.namespaces import Computer, Field, Running, until

pytestmark = pytest.mark.namespaces

NEAR = 0.02
"""Formation error below which the robots are in formation [m]."""


@pytest.fixture(scope="module")
def team(bundles: Path, installed: Installed, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployed]:
    """The running mission; the tests depend on their order."""
    folder = tmp_path_factory.mktemp("field")
    with Field() as field:
        team = Deployed(field, bundles, installed, folder / "states")
        for name in team.mission.followers:
            team.start_robot(name).event("ready")
        for name in team.mission.names:
            team.start_units(name)
        team.start_monitor(folder / "run.mcap")
        for running in team.running.values():
            running.event("ready")
        yield team


def snapshot(team: Deployed) -> dict[str, Any]:
    return team.running["desk", "monitor"].event("snapshot")


def agents(team: Deployed) -> dict[str, Running]:
    """The agent of each follower, and the leader process."""
    mission = team.mission
    unit = {name: f"formation-{'leader' if name == mission.leader else 'agent'}" for name in mission.names}
    return {name: team.running[name, unit[name]] for name in mission.names}


def listening(computer: Computer) -> set[str]:
    """Addresses at which a computer accepts connections."""
    done = computer.run("ss", "-tlnH")
    return {line.split()[3] for line in done.stdout.splitlines()}


def test_team_holds_until_operator_orders_run(team: Deployed) -> None:
    until(lambda: snapshot(team)["mode"] == "hold")
    assert not any(snapshot(team)["robots"][name]["speed"] for name in team.mission.followers)
    done = team.order("run")
    assert done.returncode == 0, done.stdout + done.stderr


def test_robots_converge_to_the_formation(team: Deployed) -> None:
    def formed() -> bool:
        result = snapshot(team)
        error, states = result["formation_error"], {result["robots"][name]["state"] for name in followers}
        return error is not None and error < NEAR and result["mode"] == "run" and states == {"run"}

    followers = team.mission.followers
    until(formed, 60.0, f"all run with a formation error under {NEAR} m")


def test_agent_links_are_neighbours_and_monitor_only(team: Deployed) -> None:
    address = {name: computer.address for name, computer in team.computers.items()}
    for name, process in agents(team).items():
        links = team.computers[name].links(process.pid)
        expected = {*partners(team.mission, name), "desk"}
        assert sorted(link.peer for link in links) == sorted(address[other] for other in expected)
        assert team.computers[name].links() == links, "another process of the robot has links of its own"
    desk = team.desk.links(team.running["desk", "monitor"].pid)
    assert {link.peer for link in desk} == {address[name] for name in team.mission.names}


def test_robot_listens_only_on_agent_port_and_loopback(team: Deployed) -> None:
    for name in team.mission.names:
        own = {} if name == team.mission.leader else {"127.0.0.1:7447"}
        assert listening(team.computers[name]) == {f"{team.computers[name].address}:7460", *own}
    assert listening(team.desk) == {"127.0.0.1:8460"}, "only the page, on loopback"


def test_monitor_receives_every_robot_at_its_rate(team: Deployed) -> None:
    def received(robot: dict[str, Any]) -> bool:
        return bool(robot["rate"] == pytest.approx(20.0, rel=0.1) and robot["age"] < 0.5)

    until(lambda: all(map(received, snapshot(team)["robots"].values())), what="20 positions a second of each")
    assert set(snapshot(team)["robots"]) == set(team.mission.names)


def test_operator_stop_is_acknowledged_and_robots_stand(team: Deployed) -> None:
    done = team.order("stop")
    assert done.returncode == 0, done.stdout + done.stderr
    answers = json.loads(done.stdout.splitlines()[-1])
    assert {answer["robot"] for answer in answers["acknowledged"]} == set(team.mission.names)
    standing = time.monotonic()
    until(lambda: all(snapshot(team)["robots"][name]["speed"] == 0.0 for name in team.mission.followers))
    assert time.monotonic() - standing < 5.0


def test_monitor_certificate_cannot_give_orders(team: Deployed) -> None:
    done = team.order("release", process="monitor")
    assert done.returncode == 1
    assert json.loads(done.stdout.splitlines()[-1])["missing"] == list(team.mission.names)
    assert snapshot(team)["mode"] == "stop"


def test_mission_messages_are_never_refused(team: Deployed) -> None:
    robots = team.mission.robots
    summaries = {}
    for key, running in team.running.items():
        assert running.stop() == 0, running.errors
        summaries[key] = running.event("summary")
    for name, process in agents(team).items():
        result = process.event("summary")
        # the leader receives the orders that its dependants relay, to restore its plan after a restart
        requested = ["robot1"] if name == team.mission.leader else robots[name].neighbours
        received = {POSITION.key(other) for other in requested}
        assert set(result["received"]) == received, name
        assert {POSITION.key(name), STATUS.key(name)} <= set(result["published"])
        refused = {word for word in result["refused"] if "/order" not in word}  # orders of the monitor
        assert not refused, name
    for name in team.mission.followers:
        result = summaries[name, "formation-agent"]["robot"]
        assert set(result["received"]) == {ODOM.key(name)}
        assert result["published"][CMD_VEL.key(name)] > 100
        assert summaries[name, "formation-watchdog"]["received"] == {}
    monitor = summaries["desk", "monitor"]
    assert monitor["refused"] == {}
    assert monitor["converged"]
