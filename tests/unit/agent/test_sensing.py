"""Sensors that lie, stutter or are late, blocked wheels, carried robots: the robot holds and probes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest

from formation.agent.simulated.faults import Fault, read
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.ros2.messages import Odometry
from formation.topics import ODOM
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import altered
from tests.support.sensing import SOURCES, faulty, late, mission_of, noisy, resting, watch

BEGIN = 8.0
"""A fault begins so long after the start [s]."""
BOUND = 0.1
"""So far a robot may drive from 1 s after the fault on [m]."""


def suffering(name: str, source: str, kind: str, size: float = 0.0, lasts: float = 1e9) -> tuple[Fleet, str]:
    mission = mission_of(name, source)
    robot = mission.followers[0]
    fleet = faulty(mission, Fault(robot, kind, size, BEGIN, lasts))
    fleet.run(BEGIN + 1.0)
    return fleet, robot


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize(("kind", "size"), [("frozen", 0.0), ("tremble", 1e-3), ("blocked", 0.0)])
def test_robot_without_seen_motion_stops_and_resumes(source: str, kind: str, size: float) -> None:
    fleet, robot = suffering("six_robots", source, kind, size, lasts=6.0)
    assert fleet.driven(robot, 4.5) < BOUND
    assert fleet.agents[robot].decision.state is AgentState.HOLD
    assert "frozen or robot blocked" in str(fleet.status(robot).reason)
    assert fleet.driven(robot, 25.0) > 2.0
    assert fleet.agents[robot].decision.state is AgentState.RUN


@pytest.mark.slow
def test_probes_stay_bounded_however_long_it_lasts() -> None:
    fleet, robot = suffering("turtlebot3_pair", "odometry", "tremble", 1e-3)
    assert fleet.driven(robot, 70.0) < BOUND
    assert fleet.agents[robot].decision.probes


@pytest.mark.slow
def test_hold_and_run_probe_again_at_once() -> None:
    fleet, robot = suffering("turtlebot3_pair", "odometry", "frozen", lasts=60.0)
    fleet.run(64.0)
    assert fleet.agents[robot].decision.probes
    fleet.ask(fleet.mission.leader, "hold")
    fleet.run(0.5)
    fleet.ask(fleet.mission.leader, "run")
    fleet.run(8.0)
    assert fleet.agents[robot].decision.state is AgentState.RUN


@pytest.mark.parametrize("size", [0.0, *slow(-1.0)])
def test_reported_speeds_that_contradict_positions_hold_the_robot(size: float) -> None:
    fleet, robot = suffering("six_robots", "odometry", "speeds", size)
    decision = fleet.agents[robot].decision
    assert (decision.state, decision.reason.code) == (AgentState.HOLD, Code.MOTION_SPEEDS)
    assert "its speeds say " in str(decision.reason)


@pytest.mark.slow
def test_a_carried_robot_holds_until_it_is_put_down() -> None:
    mission = mission_of("six_robots", "external")
    fleet = faulty(mission, Fault("robot2", "carried", 0.8, BEGIN, 3.0))
    fleet.run(BEGIN + 2.0)
    reason = fleet.agents["robot2"].decision.reason
    assert reason.code in {Code.MOTION_CARRIED, Code.POSITION_JUMPED}
    fleet.run(30.0)
    assert fleet.agents["robot2"].decision.state is AgentState.RUN
    assert fleet.error() < 0.05


@pytest.mark.slow
def test_a_robot_that_spins_in_place_is_checked_by_its_heading() -> None:
    mission = mission_of("six_robots", "odometry")
    fleet = Fleet(mission).after(BEGIN)
    agent = fleet.agents["robot2"]
    held = list[Odometry]()

    def freeze(seen: Odometry) -> Odometry:
        held.append(seen)
        return replace(seen, heading=held[0].heading)  # positions follow, the heading does not

    fleet.meddle = altered(ODOM.key("robot2"), Odometry, freeze)
    fleet.ask(mission.leader, "hold")
    fleet.run(0.5)
    law = agent._params.law
    agent._params = agent._params._replace(
        law=lambda integral, *rest: (law(integral, *rest)[0]._replace(speed=0.0, turn_rate=1.0), integral)
    )
    fleet.ask(mission.leader, "run")
    fleet.run(1.5)
    assert agent.decision.reason.code is Code.MOTION_TURN


@pytest.mark.slow
@pytest.mark.parametrize("source", SOURCES)
def test_noise_and_delay_cause_no_hold(source: str) -> None:
    fleet = Fleet(noisy(mission_of("six_robots", source), 0.005), delay=(0.1, 0.101))
    fleet.meddle = late(0.1)
    assert watch(fleet, 20.0).holds == {}


@pytest.mark.slow
def test_noise_at_rest_causes_no_hold() -> None:
    fleet = Fleet(resting(noisy(mission_of("six_robots", "odometry"), 0.005)))
    fleet.meddle = late(0.1)
    assert watch(fleet, 20.0).holds == {}


@pytest.mark.parametrize(
    "text", ["robot2", "robot2:frozen", "robot2:melted@3", "robot2:tremble=x@3", "a:frozen@x"]
)
def test_a_fault_that_cannot_be_read_is_named(text: str) -> None:
    with pytest.raises(ValueError, match="must be"):
        read(text)


def test_a_fault_is_read() -> None:
    assert read("robot2:tremble=1e-3@20+10") == Fault("robot2", "tremble", 1e-3, 20.0, 10.0)


@pytest.mark.parametrize("late", [*slow(0.4, 0.6), 1.0])
def test_late_odometry_with_fresh_stamps_holds_the_robot(late: float) -> None:
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "restamped", late, 0.0))
    fleet.run(3.0)
    before = fleet.plant("robot3").path
    decision = fleet.agents["robot3"].decision
    assert decision.reason.code is Code.MOTION_LATE
    assert decision.reason.values["seen"] == pytest.approx(late, abs=0.06)
    fleet.run(9.0)
    assert fleet.plant("robot3").path - before < BOUND


@pytest.mark.slow
def test_robot_goes_on_when_odometry_is_prompt_again() -> None:
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "restamped", 0.4, 0.0, 6.0))
    fleet.run(30.0)
    assert fleet.agents["robot3"].decision.state is AgentState.RUN
    assert fleet.error() < 0.05


@pytest.mark.slow
def test_delay_within_limit_with_noise_causes_no_hold() -> None:
    mission = noisy(mission_of("six_robots", "odometry"), 0.005)
    assert watch(faulty(mission, Fault("robot2", "restamped", 0.3, 0.0)), 20.0).holds == {}


def test_stuttering_fault_drives_no_further_than_frozen() -> None:
    fleet: Fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "stutter", 0.35, 8.0))
    fleet.run(9.5)
    assert fleet.driven("robot3", 8.0) < BOUND


def bursts(fleet: Fleet, robot: str, burst: float, gap: float) -> Callable[[Sample], tuple[Sample, ...]]:
    """Lose the robot's odometry for `gap` after each `burst` [s]."""

    def meddle(sample: Sample) -> tuple[Sample, ...]:
        if sample.key == ODOM.key(robot) and fleet.now > BEGIN and fleet.now % (burst + gap) > burst:
            return ()
        return (sample,)

    return meddle


@cache
def about_to_freeze() -> Fleet:
    """A fleet just before the odometry of robot3 freezes."""
    return faulty(mission_of("six_robots", "odometry"), Fault("robot3", "frozen", 0.0, BEGIN)).after(BEGIN)


def stuttering(burst: float, gap: float) -> Fleet:
    """A fleet in which the odometry of robot3 freezes and comes in bursts."""
    fleet = about_to_freeze().copy()
    fleet.meddle = bursts(fleet, "robot3", burst, gap)
    return fleet


@pytest.mark.parametrize(("burst", "gap"), [(0.35, 0.6), *slow((0.2, 0.2))])
def test_frozen_odometry_in_bursts_holds_the_robot(burst: float, gap: float) -> None:
    fleet = stuttering(burst, gap)
    fleet.run(1.5)
    assert fleet.driven("robot3", 10.0) < BOUND
    assert fleet.agents["robot3"].motion.state.doubt is not None


def test_interrupted_probes_stay_bounded() -> None:
    fleet = stuttering(1.45, 0.2)
    fleet.run(1.5)
    assert fleet.driven("robot3", 20.0) < BOUND
    assert fleet.agents["robot3"]._probe.state.tries > 2


def test_odometry_that_comes_in_bursts_causes_no_doubt() -> None:
    fleet = Fleet(mission_of("six_robots", "odometry"))
    fleet.meddle = bursts(fleet, "robot3", 0.5, 0.3)
    while fleet.now < BEGIN + 7.0:
        fleet.run(0.1)
        assert fleet.agents["robot3"].motion.state.doubt is None
    assert fleet.agents["robot3"].decision.reason.code in {
        Code.RUNNING,
        Code.POSITION_SILENT,
        Code.POSITION_GAP,
    }
