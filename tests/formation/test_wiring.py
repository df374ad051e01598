"""Links follow the measurement graph and nothing else."""

from __future__ import annotations

import pytest

from formation.mission_file import load, parse, read, shipped
from formation.transport import wiring


@pytest.mark.parametrize("name", shipped())
def test_a_link_exists_exactly_where_one_of_two_robots_measures_the_other(name: str) -> None:
    mission = load(name)
    where = wiring.endpoints(mission)
    owner = {endpoint: robot for robot, endpoint in where.agents.items()}
    links = [
        frozenset((robot, owner[dialled]))
        for robot in mission.followers
        for dialled in wiring.of_agent(mission, robot, where).connect
        if dialled in owner
    ]
    measured = {frozenset((i, j)) for i in mission.names for j in mission.robots[i].neighbours}
    assert len(links) == len(set(links))
    assert set(links) == measured


def test_an_agent_listens_once_and_no_robot_is_in_the_fleet() -> None:
    mission = load("six_robots")
    where = wiring.endpoints(mission)
    links = wiring.of_agent(mission, "robot3", where)
    assert links.listen == (where.agents["robot3"],)
    assert not set(links.connect) & set(where.robots.values())


def test_a_process_of_simulated_robots_has_no_links_with_the_fleet() -> None:
    mission = load("six_robots")
    where = wiring.endpoints(mission)
    assert wiring.of_robots(mission, ["robot2", "robot3"], where) == ((), ())


def test_robots_are_told_apart_by_the_endpoint_that_they_are_behind() -> None:
    where = {"robot2": "tcp/desk:7447", "robot3": "tcp/c:1", "robot4": "tcp/desk:7447"}
    assert wiring.by_endpoint(where) == {"tcp/desk:7447": ("robot2", "robot4"), "tcp/c:1": ("robot3",)}


def test_a_simulated_sensor_that_looks_at_the_virtual_leader_is_linked_with_it() -> None:
    text, name = read("six_robots")
    local = parse(text.replace("rate = 20 ", 'rate = 20\nmeasurement = "local" '), name)
    where = wiring.endpoints(local)
    assert wiring.of_robots(local, local.followers, where).connect == (where.agents["robot1"],)
    assert wiring.of_robots(local, ["robot4"], where).connect == ()  # it looks at robot2 and robot3


def test_nobody_dials_the_monitor_and_the_monitor_dials_every_agent() -> None:
    mission = load("six_robots")
    where = wiring.endpoints(mission)
    monitor = wiring.of_monitor(where)
    assert monitor.listen == ()
    assert set(monitor.connect) == set(where.agents.values())


def test_no_two_processes_listen_on_one_endpoint() -> None:
    for name in shipped():
        where = wiring.endpoints(load(name))
        listened = [*where.agents.values(), *where.robots.values()]
        assert len(listened) == len(set(listened))
