"""Wrong, stuttering or late sensors, blocked wheels, carried robots: the robot holds and probes."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.following.relative_check import OwnMotion, RelativeCheck
from formation.agent.simulated.faults import Fault, parse
from formation.control.observer import Travel
from formation.control.plane import rotation
from formation.control.unicycle import along
from formation.mission.file import load
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.ros2.messages import Displacement, Odometry, Twist
from formation.topics import CMD_VEL, ODOM, RELATIVE
from formation.wire import Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import altered
from tests.support.missions import with_robots
from tests.support.sensing import SOURCES, faulty, late, mission_of, noisy, resting, watch

SIX = load("six_robots")
BEGIN = 8.0
"""Time at which a fault begins [s]."""
BOUND = 0.1
"""Greatest distance that a robot may drive from 1 s after the fault on [m]."""


def with_fault(name: str, source: str, kind: str, size: float = 0.0, lasts: float = 1e9) -> tuple[Fleet, str]:
    mission = mission_of(name, source)
    robot = mission.followers[0]
    fleet = faulty(mission, Fault(robot, kind, size, BEGIN, lasts))
    fleet.run(BEGIN + 1.0)
    return fleet, robot


@pytest.mark.slow
def test_probes_stay_bounded_during_long_fault() -> None:
    fleet, robot = with_fault("turtlebot3_pair", "odometry", "tremble", 1e-3)
    assert fleet.driven(robot, 70.0) < BOUND
    assert fleet.agents[robot].decision.probes


@pytest.mark.slow
def test_hold_and_run_restart_probing_at_once() -> None:
    fleet, robot = with_fault("turtlebot3_pair", "odometry", "frozen", lasts=60.0)
    fleet.run(64.0)
    assert fleet.agents[robot].decision.probes
    fleet.ask(fleet.mission.leader, "hold")
    fleet.run(0.5)
    fleet.ask(fleet.mission.leader, "run")
    fleet.run(8.0)
    assert fleet.agents[robot].decision.state is AgentState.RUN


@pytest.mark.parametrize("size", [0.0, *slow(-1.0)])
def test_speeds_that_contradict_positions_hold_robot(size: float) -> None:
    fleet, robot = with_fault("six_robots", "odometry", "speeds", size)
    decision = fleet.agents[robot].decision
    assert (decision.state, decision.reason.code) == (AgentState.HOLD, Code.MOTION_SPEEDS)
    assert "its speeds say " in str(decision.reason)


@pytest.mark.slow
def test_carried_robot_holds_until_put_down() -> None:
    mission = mission_of("six_robots", "external")
    fleet = faulty(mission, Fault("robot2", "carried", 0.8, BEGIN, 3.0))
    fleet.run(BEGIN + 2.0)
    reason = fleet.agents["robot2"].decision.reason
    assert reason.code in {Code.MOTION_CARRIED, Code.POSITION_JUMPED}
    fleet.run(30.0)
    assert fleet.agents["robot2"].decision.state is AgentState.RUN
    assert fleet.error() < 0.05


@pytest.mark.slow
def test_frozen_heading_of_spinning_robot_is_detected() -> None:
    mission = mission_of("six_robots", "odometry")
    fleet = Fleet(mission).after(BEGIN)
    agent = fleet.agents["robot2"]
    held = list[Odometry]()

    def freeze(seen: Odometry) -> Odometry:
        held.append(seen)
        return replace(seen, heading=held[0].heading)  # positions change, the heading does not

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


WRONG_TURNS = {
    "wheels swapped": altered(CMD_VEL.key("robot2"), Twist, lambda c: replace(c, turn_rate=-c.turn_rate)),
    "gyroscope upside down": altered(
        ODOM.key("robot2"),
        Odometry,
        lambda seen: replace(seen, heading=seen.heading.conjugate(), turn_rate=-seen.turn_rate),
    ),
}


@pytest.mark.parametrize("fault", ["wheels swapped", *slow("gyroscope upside down")])
def test_robot_that_turns_the_other_way_holds(fault: str) -> None:
    fleet = Fleet(mission_of("six_robots", "odometry"))
    fleet.meddle = WRONG_TURNS[fault]
    fleet.run(3.0)
    agent = fleet.agents["robot2"]
    assert agent.decision.reason.code is Code.MOTION_TURN
    assert "turned -" in str(agent.decision.reason)
    began = fleet.plant("robot2").position
    fleet.run(20.0)
    assert agent.decision.reason.code is Code.MOTION_TURN
    assert abs(fleet.plant("robot2").position - began) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize(("source", "rests"), [*((source, False) for source in SOURCES), ("odometry", True)])
def test_noise_and_delay_cause_no_hold(source: str, *, rests: bool) -> None:
    mission = noisy(mission_of("six_robots", source), 0.005)
    fleet = Fleet(resting(mission) if rests else mission, delay=(0.1, 0.101))
    fleet.meddle = late(0.1)
    assert watch(fleet, 20.0).holds == {}


@pytest.mark.parametrize(
    "text", ["robot2", "robot2:frozen", "robot2:melted@3", "robot2:tremble=x@3", "a:frozen@x"]
)
def test_invalid_fault_text_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="must be"):
        parse(text, SIX)


def test_fault_is_read_from_text() -> None:
    assert parse("robot2:tremble=1e-3@20+10", SIX) == Fault("robot2", "tremble", 1e-3, 20.0, 10.0)


@pytest.mark.parametrize("late", [*slow(0.4, 0.6), 1.0])
def test_late_odometry_with_fresh_stamps_holds_robot(late: float) -> None:
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "restamped", late, 0.0))
    fleet.run(3.0)
    before = fleet.plant("robot3").path
    decision = fleet.agents["robot3"].decision
    assert decision.reason.code is Code.MOTION_LATE
    assert decision.reason.values["seen"] == pytest.approx(late, abs=0.06)
    fleet.run(9.0)
    assert fleet.plant("robot3").path - before < BOUND


@pytest.mark.slow
def test_robot_resumes_when_odometry_is_prompt_again() -> None:
    fleet = faulty(mission_of("six_robots", "odometry"), Fault("robot3", "restamped", 0.4, 0.0, 6.0))
    fleet.run(30.0)
    assert fleet.agents["robot3"].decision.state is AgentState.RUN
    assert fleet.error() < 0.05


@pytest.mark.slow
def test_delay_within_limit_with_noise_causes_no_hold() -> None:
    mission = noisy(mission_of("six_robots", "odometry"), 0.005)
    assert watch(faulty(mission, Fault("robot2", "restamped", 0.3, 0.0)), 20.0).holds == {}


@pytest.mark.slow
def test_robot_with_stuttering_odometry_stops_within_bound() -> None:
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
def test_frozen_odometry_in_bursts_holds_robot(burst: float, gap: float) -> None:
    fleet = stuttering(burst, gap)
    fleet.run(1.5)
    assert fleet.driven("robot3", 10.0) < BOUND
    assert fleet.agents["robot3"].motion.state.doubt is not None


@pytest.mark.slow
def test_interrupted_probes_stay_bounded() -> None:
    fleet = stuttering(1.45, 0.2)
    fleet.run(1.5)
    assert fleet.driven("robot3", 20.0) < BOUND
    assert fleet.agents["robot3"]._probe.state.tries > 2


@pytest.mark.slow
def test_odometry_in_bursts_causes_no_doubt() -> None:
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


LOCAL = with_robots("six_robots", measurement="local")
PERIOD, ROBOT = 0.05, "robot3"
AHEAD = Travel(0.01, 0.0, 0.01 + 0j)


Seen = Callable[[int], Any]
"""A displacement of each period, or None."""


class Watched:
    """A check of the displacements to one neighbour, and the robot's motion."""

    def __init__(self, *, by_odometry: bool = True, period: float = PERIOD) -> None:
        self.check = RelativeCheck("robot2", 0.0, 0.5, by_odometry=by_odometry)
        self.own, self.time, self.period = OwnMotion(), 0.0, period

    def move(self, travel: Travel | None, periods: int, seen: Seen, reported: Seen = lambda _: None) -> bool:
        """Move on for so many `periods`; return whether the sensor is doubted then."""
        for number in range(periods):
            self.time += self.period
            self.own.add(self.time, travel)
            self.check.saw(seen(number), self.own, reported(number))
        return self.check.state.doubt is not None


def still(_: int) -> complex:
    return 1.0 + 0j


@pytest.mark.parametrize("travel", [AHEAD, Travel(0.0, 0.02, 0j)])
def test_repeated_displacement_is_doubted_while_robot_moves(travel: Travel) -> None:
    watched = Watched()
    assert not watched.move(travel, 8, still)
    assert watched.move(travel, 40, still)
    assert watched.check.state.doubt is not None
    assert watched.check.state.doubt.why.code is Code.RELATIVE_FROZEN
    assert "the sensor's robot2 frozen or this robot blocked" in str(watched.check.state.doubt.why)


def test_trembling_displacement_is_doubted_beside_standing_neighbour() -> None:
    watched = Watched()
    assert watched.move(AHEAD, 20, lambda n: 1.0 + 0.001 * (n % 3), lambda _: 1.0 + 0j)


@pytest.mark.parametrize(
    ("by_odometry", "travel", "periods", "seen", "reported"),
    [
        (True, Travel(0.0, 0.0, 0j), 400, still, lambda n: 0.01j * n),
        (True, AHEAD, 200, lambda n: 3.0 - 0.01 * n, lambda _: 3.0 + 0j),
        (True, None, 400, still, lambda _: None),
        (False, Travel(0.0, 0.02, 0j), 400, still, lambda _: None),
    ],
    ids=["at rest", "displacement follows motion", "unknown motion", "commanded turn"],
)
def test_displacement_without_evidence_against_it_is_believed(
    by_odometry: bool, travel: Travel | None, periods: int, seen: Seen, reported: Seen
) -> None:
    assert not Watched(by_odometry=by_odometry).move(travel, periods, seen, reported)


@pytest.mark.parametrize("angle", [0.0, 0.6, 3.0])
def test_formation_at_speed_causes_no_doubt_in_any_frame(angle: float) -> None:
    def reported(number: int) -> complex:
        return rotation(angle) * 0.0095 * number

    assert not Watched().move(AHEAD, 2000, lambda n: 1.0 + 1e-6 * (n % 2), reported)


@pytest.mark.parametrize("speed", [0.05, 0.1, 0.2])
def test_repeated_displacement_is_doubted_across_frequent_gaps(speed: float) -> None:
    watched, step = Watched(), speed * PERIOD
    for _ in range(round(0.6 / (8.0 * step))):
        watched.move(Travel(step, 0.0, step + 0j), 8, still)
        watched.move(None, 1, still)
    assert watched.check.state.doubt is not None


def test_noise_of_a_robot_at_rest_adds_up_to_no_doubt() -> None:
    watched, random = Watched(by_odometry=False), Random(1)
    noise = 0j
    for _ in range(300):
        for _ in range(19):
            before = noise
            noise = 0.95 * noise + 0.31 * complex(random.gauss(0.0, 0.002), random.gauss(0.0, 0.002))
            assert not watched.move(Travel(abs(noise - before), 0.0, noise - before), 1, still)
        watched.move(None, 1, still)


def test_doubt_ends_with_first_changed_displacement() -> None:
    watched, rest = Watched(), Travel(0.0, 0.0, 0j)
    assert watched.move(AHEAD, 80, still)
    assert watched.move(rest, 100, still)
    assert not watched.move(rest, 1, lambda _: 0.2 + 0j)


def test_trust_ends_doubt_only_after_one_second() -> None:
    watched = Watched()
    assert watched.move(AHEAD, 80, still)
    doubt = watched.check.state.doubt
    assert doubt is not None
    watched.check.trust(doubt.since + 0.5)
    assert watched.check.state.doubt is doubt
    watched.check.trust(doubt.since + 1.01)
    assert watched.check.state.doubt is None


TURN_AND_GO = Travel(0.02, 0.03, 0.02 + 0j)
WRONG_AXES: dict[str, Callable[[complex], complex]] = {
    "mirrored": lambda z: z.conjugate(),
    "backward": lambda z: -z,
    "exchanged": lambda z: complex(z.imag, z.real),
    "turned by 90°": lambda z: 1j * z,
}


@given(
    travels=st.lists(st.tuples(st.floats(-0.05, 0.05), st.floats(-0.1, 0.1)), min_size=1, max_size=200),
    ways=st.lists(st.complex_numbers(max_magnitude=0.025), min_size=200, max_size=200),
    first=st.complex_numbers(max_magnitude=5.0),
    scale=st.floats(0.9, 1.1),
    late=st.integers(0, 6),
    own_late=st.integers(0, 6),
    reports_late=st.integers(0, 6),
    angle=st.floats(-3.2, 3.2),
)
def test_true_displacement_is_never_contradicted(
    travels: list[tuple[float, float]],
    ways: list[complex],
    first: complex,
    scale: float,
    late: int,
    own_late: int,
    reports_late: int,
    angle: float,
) -> None:
    """Whatever both robots do, with late messages, odometry 10 % off, and frames that differ."""
    watched, here, heading, there = Watched(), 0j, 1.0 + 0j, first
    seen, said = [first], [first]
    went = [Travel(0.0, 0.0, 0j)] * (own_late + 1)
    for (distance, turn), way in zip(travels, ways, strict=False):
        here, heading = along(here, heading, distance, turn)
        there += way
        seen.append((there - here) * heading.conjugate())
        said.append(there)
        watched.time += PERIOD
        went.append(Travel(scale * distance, scale * turn, scale * distance * heading))
        watched.own.add(watched.time, went[-1 - own_late])
        shown, told = seen[max(0, len(seen) - 1 - late)], said[max(0, len(said) - 1 - reports_late)]
        watched.check.saw(shown, watched.own, rotation(angle) * told)
        doubt = watched.check.state.doubt
        assert doubt is None or doubt.why.code is not Code.RELATIVE_CONTRADICTED


def test_displacement_between_odometry_messages_is_not_contradicted() -> None:
    watched, turn = Watched(period=0.5), Travel(0.0, 0.6, 0j)
    watched.move(Travel(0.0, 0.0, 0j), 5, lambda _: 2.0 + 0j, lambda _: 0j)
    assert not watched.move(turn, 8, lambda n: 2.0 * rotation(-0.6 * (n + 1.5)), lambda _: 0j)


def test_neighbour_with_rare_messages_is_not_contradicted() -> None:
    watched = Watched()
    for number in range(200):
        watched.time += PERIOD
        watched.own.add(watched.time, Travel(0.0, 0.0, 0j))
        silent = number % 40
        seen, told = 1.0 + 0.025 * number, 0.025 * (number - silent) + 0j
        watched.check.saw(seen, watched.own, told, report_age=silent * PERIOD)
        assert watched.check.state.doubt is None


@pytest.mark.parametrize("wrong", WRONG_AXES.values(), ids=WRONG_AXES)
def test_displacement_along_wrong_axes_is_contradicted_until_order(
    wrong: Callable[[complex], complex],
) -> None:
    watched, here, heading = Watched(), 0j, 1.0 + 0j
    for _ in range(60):
        here, heading = along(here, heading, TURN_AND_GO.distance, TURN_AND_GO.turn)
        shown = wrong((2.0 + 1.0j - here) * heading.conjugate())
        watched.move(TURN_AND_GO, 1, lambda _, shown=shown: shown, lambda _: 2.0 + 1.0j)  # type: ignore[misc]
    doubt = watched.check.state.doubt
    assert doubt is not None
    assert doubt.why.code is Code.RELATIVE_CONTRADICTED
    watched.move(Travel(0.0, 0.0, 0j), 200, still, still)
    assert watched.check.state.doubt is doubt
    watched.check.trust(watched.time)
    assert watched.check.state.doubt is None


@pytest.mark.parametrize("wrong", WRONG_AXES.values(), ids=WRONG_AXES)
def test_robot_with_wrong_axes_of_its_sensor_holds_until_order(wrong: Callable[[complex], complex]) -> None:
    mission = with_robots("turtlebot3_pair", measurement="local")
    fleet, robot = Fleet(mission), mission.followers[-1]
    keys = {RELATIVE.key(robot, other) for other in mission.robots[robot].measurable}

    def turned(one: Displacement) -> Displacement:
        return replace(one, displacement=wrong(one.displacement))

    meddles = {key: altered(key, Displacement, turned) for key in keys}
    fleet.meddle = lambda one: meddles[one.key](one) if one.key in keys else (one,)
    fleet.run(12.0)
    assert fleet.plant(robot).path < 0.8
    reason = fleet.agents[robot].decision.reason
    assert reason.code is Code.RELATIVE_CONTRADICTED
    assert "check whether either robot was carried, the sensor's axes" in str(reason)
    fleet.meddle = lambda one: (one,)
    fleet.run(5.0)
    assert fleet.agents[robot].decision.state is AgentState.HOLD
    fleet.ask(mission.leader, "hold")
    fleet.run(2.0)
    fleet.ask(mission.leader, "run")
    fleet.run(2.0)
    assert fleet.agents[robot].decision.state is AgentState.RUN


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        ("patrol", Fault("robot2", "restamped", 0.15, 0.0)),
        *slow(("six_robots", Fault("robot3", "restamped", 0.15, 0.0))),
        *slow(("turtlebot3_pair", Fault("robot1", "stutter", 0.35, BEGIN, 3.0))),
    ],
)
def test_late_odometry_contradicts_no_displacement(name: str, fault: Fault) -> None:
    fleet = faulty(with_robots(name, measurement="local"), fault)
    fleet.run(3.0 if fault.since == 0.0 else BEGIN + 3.0)
    for one in fleet.agents[fault.robot].neighbours.each.values():
        assert one.check is not None
        doubt = one.check.state.doubt
        assert doubt is None or doubt.why.code is not Code.RELATIVE_CONTRADICTED


def late_displacements(seconds: float) -> Callable[[Sample], Iterable[Sample]]:
    keys = {RELATIVE.key(ROBOT, other) for other in LOCAL.robots[ROBOT].measurable}
    return lambda one: (one._replace(arrived=one.arrived + seconds),) if one.key in keys else (one,)


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_robot_holds_while_its_displacements_are_late(seconds: float) -> None:
    fleet = Fleet(LOCAL)
    fleet.meddle = late_displacements(seconds)
    fleet.run(6.0)
    assert fleet.plant(ROBOT).path < 0.02
    reason = fleet.agents[ROBOT].decision.reason
    assert reason.code is Code.RELATIVE_LATE
    assert f"{seconds:.2f} s old when it came; limit 0.20 s" in str(reason)
    fleet.meddle = lambda one: (one,)
    fleet.run(2.0)
    assert fleet.agents[ROBOT].decision.state is AgentState.RUN
