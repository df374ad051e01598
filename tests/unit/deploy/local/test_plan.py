"""The process table: which processes a mission has on this machine, and who is linked with whom."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from formation.deploy.local.launch import GRACE, STOP_ORDER
from formation.deploy.local.plan import Part, programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.monitor.metrics.keys import given_stage


def flags_of(argv: Sequence[str], flag: str) -> list[str]:
    return [argv[i + 1] for i, word in enumerate(argv) if word == flag]


def test_plan_has_one_process_per_agent() -> None:
    mission = load("six_robots")
    with Ports(mission) as ports:
        where = ports.endpoints
        plan = programs(mission, "six_robots", where, parent=4711, record=Path("a.mcap"), law="paper")
    table = {one.name: one.argv for one in plan}
    assert list(table) == ["monitor", "robots", "leader", *(f"agent {robot}" for robot in mission.followers)]
    agent = table["agent robot4"]
    assert set(flags_of(agent, "-e")) == {where.agents["robot2"], where.agents["robot3"]}
    assert flags_of(agent, "-l") == [where.agents["robot4"]]
    assert flags_of(agent, "--robot-connect") == [where.robots["robot4"]]
    assert flags_of(agent, "--law") == ["paper"]
    assert flags_of(table["robots"], "-l") == list(where.robots.values())
    assert flags_of(table["robots"], "-e") == []
    assert set(flags_of(table["monitor"], "-e")) == set(where.agents.values())
    stage = given_stage(mission, flags_of(table["monitor"], "--stage"))
    assert stage == where.robots
    assert all(flags_of(one.argv, "--parent") == ["4711"] for one in plan)
    assert all("--await-monitor" in one.argv for one in plan if one.name != "monitor")


def test_other_world_changes_only_the_robots_process() -> None:
    mission = load("six_robots")
    with Ports(mission) as ports:
        kinematic, physics = (
            programs(mission, "six_robots", ports.endpoints, parent=1, record=Path("a.mcap"), world=world)
            for world in ((), ("--world", "mujoco"))
        )
    changed = [(one, other) for one, other in zip(kinematic, physics, strict=True) if one != other]
    ((one, other),) = changed
    assert one.name == other.name == "robots"
    assert flags_of(other.argv, "--world") == ["mujoco"]
    assert flags_of(other.argv, "-l") == flags_of(one.argv, "-l")


def test_standbys_are_leader_processes_linked_with_team() -> None:
    mission = load("patrol")
    with Ports(mission) as ports:
        where = ports.endpoints
        plan = programs(mission, "patrol", where, parent=1, record=Path("a.mcap"))
    names = [one.name for one in plan]
    assert names[:5] == ["monitor", "robots", "leader", "standby deputy", "standby reserve"]
    assert names[5:] == [f"agent {name}" for name in mission.followers]
    leader, deputy, reserve = plan[2:5]
    assert {one.part for one in plan[2:]} == {"control"}  # they end together, before the robots
    assert deputy.argv[3:6] == ("formation.leader", "patrol", "--standby")
    assert flags_of(deputy.argv, "--standby") == ["deputy"]
    assert flags_of(leader.argv, "--standby") == []
    assert flags_of(leader.argv, "-e") == []
    followers = [where.agents[name] for name in mission.followers]
    assert flags_of(deputy.argv, "-e") == [where.agents["leader"], *followers]
    assert flags_of(reserve.argv, "-e") == [*flags_of(deputy.argv, "-e"), where.agents["deputy"]]
    for one in (leader, deputy, reserve):
        name = flags_of(one.argv, "--standby") or ["leader"]
        assert flags_of(one.argv, "-l") == [where.agents[name[0]]]
    assert set(flags_of(plan[0].argv, "-e")) == set(where.agents.values())
    fallback = next(one.argv for one in plan if one.name == "agent robot2")
    assert flags_of(fallback, "-e") == [where.agents["leader"], where.agents["robot1"]]


def test_watchdogs_end_after_agents_and_before_robots() -> None:
    mission = load("turtlebot3_pair")
    with Ports(mission) as ports:
        where = ports.endpoints
        plan = programs(mission, "pair", where, parent=1, record=Path("a.mcap"), watchdogs=True)
    watchdogs = {one.name: one for one in plan if one.part == "watchdog"}
    assert list(watchdogs) == ["watchdog robot1", "watchdog robot2"]
    argv = watchdogs["watchdog robot2"].argv
    assert argv[3:] == (
        "formation.agent.watchdog", "pair", "--robot", "robot2", "--robot-connect", where.robots["robot2"],
        "--parent", "1",
    )  # fmt: skip
    assert STOP_ORDER.index("control") < STOP_ORDER.index("watchdog") < STOP_ORDER.index("body")
    assert set(STOP_ORDER) == set(get_args(Part)) == set(GRACE)


def test_simulated_sensor_of_leader_is_linked_with_it() -> None:
    mission = load("turtlebot3_pair")
    robots = {
        name: robot.model_copy(update={"measurement": "local"}) for name, robot in mission.robots.items()
    }
    local = mission.model_copy(update={"robots": robots})
    with Ports(local) as ports:
        plan = programs(local, "pair", ports.endpoints, parent=1, record=Path("a.mcap"))
        argv = next(one.argv for one in plan if one.name == "robots")
        assert argv[argv.index("-e") + 1] == ports.endpoints.agents["leader"]
