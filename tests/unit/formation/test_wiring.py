"""Links follow the measurement graph, its fallbacks, and who may lead."""

from __future__ import annotations

from itertools import combinations

import pytest

from formation.mission.file import load, parse, read, shipped
from formation.mission.model import Mission
from formation.transport import wiring
from tests.support.edited import edited

STANDBYS = "[standbys.north]\n[standbys.south]\n"
SIX = "\n".join(line for line in read("six_robots")[0].split("\n") if not line.startswith("avoid ="))
"""In which robots avoid only those that they measure."""
FALLBACK = edited(SIX, "robots.robot6", 'fallback_neighbours = ["robot2", "robot1"]')


def links(mission: Mission) -> list[frozenset[str]]:
    """All links of the fleet, from whoever dials."""
    where = wiring.endpoints(mission)
    owner = {endpoint: name for name, endpoint in where.agents.items()}
    of = {name: wiring.of_member(mission, name, where) for name in mission.followers}
    of |= {name: wiring.of_member(mission, name, where) for name in mission.candidates}
    for name, ends in of.items():
        assert ends.listen == (where.agents[name],)
    return [frozenset((name, owner[end])) for name, ends in of.items() for end in ends.connect]


def measured(mission: Mission) -> set[frozenset[str]]:
    return {frozenset((i, j)) for i in mission.names for j in mission.robots[i].neighbours}


def test_avoiding_robots_are_linked_but_leader_is_not() -> None:
    mission = parse(edited(SIX, "robots.robot2", 'avoid = ["robot6"]'))
    assert set(links(mission)) == measured(mission) | {frozenset(("robot2", "robot6"))}
    everybody = parse(edited(SIX, "robot", 'avoid = "all"'))
    among = {frozenset(pair) for pair in combinations(everybody.followers, 2)}
    assert set(links(everybody)) == measured(everybody) | among


@pytest.mark.parametrize("name", [name for name in shipped() if not load(name).standbys])
def test_links_exist_exactly_between_robots_that_listen(name: str) -> None:
    mission = load(name)
    assert len(links(mission)) == len(set(links(mission)))
    assert set(links(mission)) == {frozenset((i, j)) for i in mission.names for j in mission.received_by(i)}


def test_a_fallback_neighbour_is_linked_before_it_is_needed() -> None:
    mission = parse(FALLBACK)
    more = {frozenset(("robot6", "robot2")), frozenset(("robot6", "robot1"))}
    assert len(links(mission)) == len(set(links(mission)))
    assert set(links(mission)) == measured(mission) | more
    assert wiring.partners(mission, "robot2") == ("robot1", "robot3", "robot4", "robot6")


def test_every_candidate_is_linked_with_all_robots() -> None:
    mission = parse(SIX + STANDBYS)
    leaders = ("robot1", "north", "south")
    followers = {frozenset((one, name)) for one in leaders for name in mission.followers}
    among = {frozenset(pair) for pair in combinations(leaders, 2)}
    assert len(links(mission)) == len(set(links(mission)))
    assert set(links(mission)) == measured(mission) | followers | among


def test_standby_connects_to_all_others_declared_earlier() -> None:
    mission = parse(SIX + STANDBYS)
    assert wiring.called(mission, "robot1") == ()
    assert wiring.called(mission, "north") == mission.names
    assert wiring.called(mission, "south") == (*mission.names, "north")
    assert wiring.partners(mission, "robot1") == (*mission.followers, "north", "south")


def test_leader_with_cohesion_is_linked_with_whole_team() -> None:
    mission = parse(SIX + "[cohesion]\nerror = 0.5\n")
    team = {frozenset(("robot1", name)) for name in mission.followers}
    assert len(links(mission)) == len(set(links(mission)))
    assert set(links(mission)) == measured(mission) | team


def test_standby_ports_follow_the_robots_ports() -> None:
    before, after = wiring.endpoints(parse(SIX)), wiring.endpoints(parse(SIX + STANDBYS))
    assert after.robots == before.robots
    assert dict(after.agents) == {
        **before.agents,
        "north": "tcp/127.0.0.1:7466",
        "south": "tcp/127.0.0.1:7467",
    }
    named = parse(SIX + '[standbys.north]\nendpoint = "tcp/192.168.1.9:7460"\n')
    assert wiring.endpoints(named).agents["north"] == "tcp/192.168.1.9:7460"


def test_an_agent_listens_once_and_no_robot_is_in_the_fleet() -> None:
    mission = load("six_robots")
    where = wiring.endpoints(mission)
    links = wiring.of_member(mission, "robot3", where)
    assert links.listen == (where.agents["robot3"],)
    assert not set(links.connect) & set(where.robots.values())


def test_a_process_of_simulated_robots_has_no_links_with_the_fleet() -> None:
    mission = load("six_robots")
    where = wiring.endpoints(mission)
    assert wiring.of_robots(mission, ["robot2", "robot3"], where) == ((), ())


def test_robots_are_told_apart_by_the_endpoint_that_they_are_behind() -> None:
    where = {"robot2": "tcp/desk:7447", "robot3": "tcp/c:1", "robot4": "tcp/desk:7447"}
    assert wiring.by_endpoint(where) == {"tcp/desk:7447": ("robot2", "robot4"), "tcp/c:1": ("robot3",)}


def test_simulated_sensor_of_virtual_leader_is_linked() -> None:
    sensing = SIX.replace("rate = 20 ", 'rate = 20\nmeasurement = "local" ')
    local = parse(sensing)
    where = wiring.endpoints(local)
    assert wiring.of_robots(local, local.followers, where).connect == (where.agents["robot1"],)
    assert wiring.of_robots(local, ["robot4"], where).connect == ()  # it looks at robot2 and robot3
    shared = parse(sensing + STANDBYS)
    where = wiring.endpoints(shared)
    leaders = tuple(where.agents[name] for name in ("robot1", "north", "south"))
    assert wiring.of_robots(shared, shared.followers, where).connect == leaders


@pytest.mark.parametrize("standbys", ["", STANDBYS])
def test_monitor_dials_all_and_is_dialled_by_none(standbys: str) -> None:
    mission = parse(SIX + standbys)
    where = wiring.endpoints(mission)
    monitor = wiring.of_monitor(where)
    assert monitor.listen == ()
    assert set(monitor.connect) == set(where.agents.values())


def test_no_two_processes_listen_on_one_endpoint() -> None:
    for name in shipped():
        where = wiring.endpoints(load(name))
        listened = [*where.agents.values(), *where.robots.values()]
        assert len(listened) == len(set(listened))
