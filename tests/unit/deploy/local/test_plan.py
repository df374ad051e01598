"""The process table: processes of a mission on this machine, and their links."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from formation.deploy.local.launch import STOP_ORDER, STOP_TIMEOUTS
from formation.deploy.local.plan import Part, Program, programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.mission.model import Mission
from formation.monitor.metrics.keys import given_stage
from formation.transport.wiring import Endpoints
from tests.support.missions import with_robots


def flags_of(argv: Sequence[str], flag: str) -> list[str]:
    return [argv[i + 1] for i, word in enumerate(argv) if word == flag]


def planned(mission: Mission, **options: Any) -> tuple[dict[str, Program], Endpoints]:
    """Programs by name, and where they listen."""
    with Ports(mission) as ports:
        plan = programs(mission, "MISSION", ports.endpoints, parent=4711, record=Path("a.mcap"), **options)
        return {one.name: one for one in plan}, ports.endpoints


def test_plan_has_one_process_per_agent() -> None:
    mission = load("six_robots")
    plan, where = planned(mission, law="paper")
    assert list(plan) == ["monitor", "robots", "leader", *(f"agent {robot}" for robot in mission.followers)]
    agent, monitor, robots = (plan[name].argv for name in ("agent robot4", "monitor", "robots"))
    assert set(flags_of(agent, "-e")) == {where.agents["robot2"], where.agents["robot3"]}
    assert flags_of(agent, "-l") == [where.agents["robot4"]]
    assert flags_of(agent, "--robot-connect") == [where.robots["robot4"]]
    assert flags_of(agent, "--law") == ["paper"]
    assert flags_of(robots, "-l") == list(where.robots.values())
    assert flags_of(robots, "-e") == []
    assert set(flags_of(monitor, "-e")) == set(where.agents.values())
    assert given_stage(mission, flags_of(monitor, "--stage")) == where.robots
    assert all(flags_of(one.argv, "--parent") == ["4711"] for one in plan.values())
    assert all("--await-monitor" in one.argv for name, one in plan.items() if name != "monitor")


def test_other_world_changes_only_the_robots_process() -> None:
    mission = load("six_robots")
    with Ports(mission) as ports:
        kinematic, physics = (
            programs(mission, "six_robots", ports.endpoints, parent=1, record=Path("a.mcap"), world=world)
            for world in ((), ("--world", "mujoco"))
        )
    ((one, other),) = [pair for pair in zip(kinematic, physics, strict=True) if pair[0] != pair[1]]
    assert one.name == other.name == "robots"
    assert flags_of(other.argv, "--world") == ["mujoco"]
    assert flags_of(other.argv, "-l") == flags_of(one.argv, "-l")


def test_standbys_are_leader_processes_linked_with_team() -> None:
    mission = load("patrol")
    plan, where = planned(mission)
    agents = [f"agent {name}" for name in mission.followers]
    assert list(plan) == ["monitor", "robots", "leader", "standby deputy", "standby reserve", *agents]
    assert {one.part for one in [*plan.values()][2:]} == {"control"}  # they end together, before the robots
    leader, deputy, reserve = (plan[name].argv for name in ("leader", "standby deputy", "standby reserve"))
    assert deputy[3:6] == ("formation.leader", "MISSION", "--standby")
    assert flags_of(deputy, "--standby") == ["deputy"]
    assert flags_of(leader, "--standby") == []
    assert flags_of(leader, "-e") == []
    followers = [where.agents[name] for name in mission.followers]
    assert flags_of(deputy, "-e") == [where.agents["leader"], *followers]
    assert flags_of(reserve, "-e") == [*flags_of(deputy, "-e"), where.agents["deputy"]]
    for name, argv in (("leader", leader), ("deputy", deputy), ("reserve", reserve)):
        assert flags_of(argv, "-l") == [where.agents[name]]
    assert set(flags_of(plan["monitor"].argv, "-e")) == set(where.agents.values())
    assert flags_of(plan["agent robot2"].argv, "-e") == [where.agents["leader"], where.agents["robot1"]]


def test_watchdogs_end_after_agents_and_before_robots() -> None:
    plan, where = planned(load("turtlebot3_pair"), watchdogs=True)
    watchdogs = [name for name, one in plan.items() if one.part == "watchdog"]
    assert watchdogs == ["watchdog robot1", "watchdog robot2"]
    assert plan["watchdog robot2"].argv[3:] == (
        "formation.agent.watchdog", "MISSION", "--robot", "robot2", "--robot-connect", where.robots["robot2"],
        "--parent", "4711",
    )  # fmt: skip
    assert STOP_ORDER.index("control") < STOP_ORDER.index("watchdog") < STOP_ORDER.index("body")
    assert set(STOP_ORDER) == set(get_args(Part)) == set(STOP_TIMEOUTS)


def test_robots_process_dials_leader_with_local_measurement() -> None:
    plan, where = planned(with_robots("turtlebot3_pair", measurement="local"))
    assert flags_of(plan["robots"].argv, "-e")[0] == where.agents["leader"]
