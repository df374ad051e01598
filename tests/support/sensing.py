"""Fleets whose sensors lie: how far does a robot drive on, and does it go on by itself?"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from typing import NamedTuple

from formation.agent.simulated.faults import Fault, with_faults
from formation.agent.simulated.simulated import kinematic
from formation.mission.model import Mission, SimulatedRobot
from formation.protocol.status import AgentState
from formation.wire import Sample
from tests.support.fleet import Fleet
from tests.support.missions import with_robots

MISSIONS = ("six_robots", "turtlebot3_pair", "patrol", "two_chains")
SOURCES = ("odometry", "external")
FAULTS = (("frozen", 0.0), ("tremble", 1e-6), ("tremble", 1e-3))
"""Kind and size [m] of the faults that must stop a robot."""
GRACE = 1.0
"""From so long after the fault on a robot may not drive [s]."""
PATIENCE = 90.0
"""Within so long after the fault a robot drives again by itself [s]."""


class Sensed(NamedTuple):
    """What came of one fault."""

    driven: float
    """From `GRACE` after the fault began until it ended [m]."""
    resumed: float
    """After the fault ended until the robot was in formation control again [s]."""
    held: bool
    """Whether the robot held for its own motion while the fault lasted."""


def mission_of(name: str, source: str) -> Mission:
    """A shipped mission whose robots are localised by their odometry or from outside."""
    return with_robots(name, localisation=source)


def faulty(mission: Mission, fault: Fault, seed: int = 0) -> Fleet:
    """A fleet with one fault."""
    return Fleet(mission, seed=seed, plants=with_faults(kinematic, [fault]))


def suffer(name: str, source: str, kind: str, size: float, seed: int, lasts: float = 10.0) -> Sensed:
    """One fault of one robot at a random moment, under way to its slot or in formation."""
    mission, chance = mission_of(name, source), random.Random(f"{name} {source} {kind} {size} {seed}")
    robot, since = chance.choice(mission.followers), chance.uniform(3.0, 20.0)
    fleet = faulty(mission, Fault(robot, kind, size, since, lasts), seed)
    agent, plant, held = fleet.agents[robot], fleet.plant(robot), False
    fleet.run(since + GRACE)
    before = plant.path
    while fleet.now < since + lasts:
        held |= agent.decision.probes
        fleet.run(0.25)
    driven = plant.path - before
    while agent.decision.state is not AgentState.RUN and fleet.now < since + lasts + PATIENCE:
        fleet.run(0.5)
    resumed = fleet.now - since - lasts if agent.decision.state is AgentState.RUN else float("inf")
    return Sensed(driven, resumed, held)


class Quiet(NamedTuple):
    """What came of a mission without any fault."""

    holds: dict[str, str]
    """Robots that held because their motion seemed wrong, and the reason."""
    commands: int
    """Commands in which they were judged."""


def noisy(mission: Mission, noise: float) -> Mission:
    """The mission with `noise` [m] in all positions of its simulated robots."""
    body = mission.simulated_robot.model_dump(exclude_none=True) | {"position_noise": noise}
    return mission.model_copy(update={"simulated_robot": SimulatedRobot.model_validate(body)})


def resting(mission: Mission) -> Mission:
    """The mission with a leader that stands where it starts."""
    return mission.model_copy(update={"route": (mission.route[0].model_copy(update={"speed": 0.0}),)})


def late(by: float) -> Callable[[Sample], Iterable[Sample]]:
    """What makes every robot's own measurement arrive so much later [s]."""

    def meddle(sample: Sample) -> tuple[Sample]:
        own = sample.key.endswith(("/odom", "/pose"))
        return (sample._replace(arrived=sample.arrived + by) if own else sample,)

    return meddle


def watch(fleet: Fleet, seconds: float) -> Quiet:
    """Drive for so long; who held because its motion seemed wrong."""
    holds: dict[str, str] = {}
    end = fleet.now + seconds
    while fleet.now < end:
        fleet.run(0.25)
        for name, agent in fleet.agents.items():
            if agent.decision.probes:
                holds.setdefault(name, f"{fleet.now:.1f} s: {agent.decision.reason!s}")
    return Quiet(holds, sum(len(one) for one in fleet.commands.values()))
