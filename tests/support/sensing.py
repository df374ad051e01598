"""Fleets whose sensors lie: how far does a robot drive on, and does it go on by itself?"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from formation.agent.simulated.faults import Fault, with_faults
from formation.agent.simulated.plant import Moving, Plant
from formation.agent.simulated.simulated import kinematic
from formation.mission.model import Mission, SimulatedRobot
from formation.wire import Sample
from tests.support.fleet import Fleet
from tests.support.missions import with_robots

MISSIONS = ("six_robots", "turtlebot3_pair", "patrol", "two_chains")
SOURCES = ("odometry", "external")
FAULTS = (
    ("frozen", 0.0),
    *(("tremble", size) for size in (1e-6, 1e-5, 1e-4, 1e-3)),
    *(("stale", late) for late in (0.3, 0.5, 1.0, 2.0, 4.0)),
    ("backlog", 1.0),
)
"""Kind and size of the faults that must stop a robot."""
GRACE = 1.0
"""From so long after the fault on a robot may not drive [s]."""


def reset_odometry(body: Moving) -> None:
    """Restart odometry at the present pose, as a TurtleBot3's `reset_odometry` does."""
    assert isinstance(body, Plant)
    body._counts_from = body._believed, body.heading


def mission_of(name: str, source: str) -> Mission:
    """A shipped mission whose robots are localised by their odometry or from outside."""
    return with_robots(name, localisation=source)


def faulty(mission: Mission, fault: Fault, seed: int = 0) -> Fleet:
    """A fleet with one fault."""
    return Fleet(mission, seed=seed, plants=with_faults(kinematic, [fault]))


class Quiet(NamedTuple):
    """What came of a mission without any fault."""

    holds: dict[str, str]
    """Robots that held because their motion seemed wrong, and the reason."""
    commands: int
    """Commands in which they were judged."""


def noisy(mission: Mission, noise: float) -> Mission:
    """The mission with `noise` [m] in all positions of its simulated robots, which it states."""
    body = mission.simulated_robot.model_dump(exclude_none=True) | {"position_noise": noise}
    stated = max(noise, mission.collisions.noise)
    return mission.model_copy(
        update={
            "simulated_robot": SimulatedRobot.model_validate(body),
            "collisions": mission.collisions.model_copy(update={"noise": stated}),
        }
    )


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
    """Drive for so long; the robots that held because their motion seemed wrong."""
    holds: dict[str, str] = {}
    end = fleet.now + seconds
    while fleet.now < end:
        fleet.run(0.25)
        for name, agent in fleet.agents.items():
            if agent.decision.probes:
                holds.setdefault(name, f"{fleet.now:.1f} s: {agent.decision.reason!s}")
    return Quiet(holds, sum(len(one) for one in fleet.commands.values()))
