"""Ports of a run: those of the mission if they are free, reserved until their process listens."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import ExitStack, suppress

import pytest

from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.mission.model import Mission
from formation.transport import wiring
from tests.support.child import free_endpoint


@pytest.fixture
def mission(monkeypatch: pytest.MonkeyPatch) -> Mission:
    """A pair on ports that no process uses, of this run of the tests or of another."""
    pair = load("turtlebot3_pair")
    monkeypatch.setattr(wiring, "ROBOT_PORT", free_ports(len(pair.names)))
    return with_endpoints(pair, "endpoint", {name: free_endpoint() for name in pair.names})


def free_ports(number: int) -> int:
    """Return the first of so many free ports in a row."""
    while True:
        first = port(free_endpoint())
        with suppress(OSError), ExitStack() as stack:
            for one in range(first, first + number):
                stack.enter_context(socket.socket()).bind(("127.0.0.1", one))
            return first


def with_endpoints(mission: Mission, key: str, ends: Mapping[str, str]) -> Mission:
    """Return `mission` with other endpoints, by robot."""
    moved = {name: mission.robots[name].model_copy(update={key: end}) for name, end in ends.items()}
    return mission.model_copy(update={"robots": {**mission.robots, **moved}})


def is_local(endpoint: str) -> bool:
    """Whether the endpoint is plain TCP on this machine."""
    return endpoint.startswith("tcp/127.0.0.1:")


def port(endpoint: str) -> int:
    return int(endpoint.rpartition(":")[2])


def listen(number: int) -> socket.socket:
    """Listen with the socket options of Zenoh."""
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", number))
    listener.listen()
    return listener


def test_free_ports_of_mission_are_used(mission: Mission) -> None:
    with Ports(mission) as ports:
        assert ports.as_in_mission
        assert ports.endpoints == wiring.endpoints(mission)


def test_intended_process_can_listen_on_reserved_port(mission: Mission) -> None:
    with Ports(mission) as ports, listen(port(ports.endpoints.agents["robot1"])):
        pass


def test_other_process_cannot_bind_reserved_port(mission: Mission) -> None:
    with Ports(mission) as ports, socket.socket() as stranger, pytest.raises(OSError, match="in use"):
        stranger.bind(("127.0.0.1", port(ports.endpoints.robots["robot1"])))


def test_taken_agent_port_moves_all_agent_ports(mission: Mission) -> None:
    wanted = wiring.endpoints(mission)
    with listen(port(wanted.agents["robot2"])), Ports(mission) as ports:
        assert not ports.as_in_mission
        ends = [*ports.endpoints.agents.values(), *ports.endpoints.robots.values()]
        assert not set(ends) & set(wanted.agents.values())
        assert len(set(ends)) == len(ends) == 5
        with listen(port(ends[0])):
            pass


def test_taken_robot_port_does_not_move_agent_ports(mission: Mission) -> None:
    wanted = wiring.endpoints(mission)
    with listen(port(wanted.robots["robot2"])), Ports(mission) as ports:
        assert ports.as_in_mission
        assert ports.endpoints.agents == wanted.agents
        assert not set(ports.endpoints.robots.values()) & set(wanted.robots.values())
        assert all(map(is_local, ports.endpoints.robots.values()))


def test_simultaneous_runs_share_no_agent_port(mission: Mission) -> None:
    with Ports(mission) as first, Ports(mission) as second:
        assert first.as_in_mission
        assert not second.as_in_mission
        ends = {*first.endpoints.agents.values(), *second.endpoints.agents.values()}
        assert len(ends) == 6


def test_ports_are_free_after_run_ends(mission: Mission) -> None:
    with Ports(mission), Ports(mission):
        pass
    with Ports(mission) as ports:
        assert ports.as_in_mission


def test_connection_in_time_wait_leaves_port_free(mission: Mission) -> None:
    number = port(wiring.endpoints(mission).agents["robot1"])
    with listen(number) as listener, socket.create_connection(("127.0.0.1", number)) as dialler:
        accepted, _ = listener.accept()
        accepted.close()  # the side that closes first keeps the port in TIME_WAIT
        dialler.recv(1)
    with Ports(mission) as ports:
        assert ports.as_in_mission


@pytest.mark.parametrize("end", ["tcp/192.168.1.11:7447", "tls/robot1.local:7447", "tls/127.0.0.1:17460"])
def test_remote_or_tls_endpoint_is_replaced_by_local_one(mission: Mission, end: str) -> None:
    with Ports(with_endpoints(mission, "endpoint", {"robot1": end})) as ports:
        assert not ports.as_in_mission
        assert all(map(is_local, ports.endpoints.agents.values()))


@pytest.mark.parametrize("robots", [("robot1",), ("robot1", "robot2")])
def test_simulated_robots_do_not_use_router_endpoint(mission: Mission, robots: tuple[str, ...]) -> None:
    router = "tcp/127.0.0.1:17447"
    with Ports(with_endpoints(mission, "robot_endpoint", dict.fromkeys(robots, router))) as ports:
        assert ports.as_in_mission
        ends = ports.endpoints.robots.values()
        assert router not in ends
        assert len(set(ends)) == 2
        assert all(map(is_local, ends))


def test_killed_launcher_releases_its_ports() -> None:
    code = """
import time
from formation.deploy.local.ports import Ports
from formation.mission.file import load
ports = Ports(load("turtlebot3_pair"))
print(ports.endpoints.agents["robot1"], ports.as_in_mission, flush=True)
time.sleep(600)
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        held = port(process.stdout.readline().split()[0])
        process.kill()
        process.wait(10.0)
    with listen(held):
        pass
