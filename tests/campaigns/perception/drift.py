"""How true relative positions stay: production agents of a hexagon on a virtual clock; odometry drifts."""

from __future__ import annotations

import cmath
from collections.abc import Callable, Sequence
from typing import NamedTuple

from formation.agent.perception.perception import Expected, Perception
from formation.deploy.rehearsal import fleet as rehearsed
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.engine import UPTIME
from formation.deploy.rehearsal.fleet import Fleet, Plants, WorldName
from formation.mission.model import Mission
from formation.sensing.detection import Detection
from tests.campaigns.perception import posts
from tests.support import seeing
from tests.support.seeing import HEXAGON_TEAM, STRAIGHT, Errors, Team, displaced, edges, misfit, rms

ROUTES = {
    "straight": STRAIGHT,
    "circle": "[[route]]\nradius = 2.0\nspeed = 0.15\nheading_deg = 0",
    "stop-and-go": "\n".join(
        f"[[route]]\nspeed = {speed}\nheading_deg = {heading}\nduration = {duration}"
        for heading in range(0, 360 * 8, 60)
        for speed, duration in ((0.15, 10), (0.0, 5))
    ),
    "s-curve": "[[route]]\nspeed = 0.1\nheading_deg = 0\nduration = 15"
    + "".join(
        f'\n[[route]]\nradius = 1.5\nspeed = 0.1\nturn = "{turn}"\nduration = 15.7'
        for turn in ("left", "right", "right", "left")
    ),
}
"""Routes of the leader, as the mission file has them."""
BLIND = 40, 70
"""When a robot sees nothing, in cases with that [s]."""
FINE_BEAMS = 1440
"""Beams of a simulated scanner from which those of a driver are chosen."""
MAX_OFF, MAX_OFF_SHARE = 0.06, 0.07
"""Distance of a detection from the true robot [m], and as a share of the range, from which it is another."""


class Case(NamedTuple):
    """What is measured."""

    route: str = "straight"
    measurement: str = "scan"
    world: WorldName = "kinematic"
    errors: Errors = Errors()
    team: Team = HEXAGON_TEAM
    weather: Weather = Weather()
    scanner: str = ""
    """Model of the scanners; without one scans are of one moment."""
    drivers: bool = False
    """Whether scans are as the model's driver sends them."""
    blinds: bool = False
    """Whether one robot, not the anchor, sees nothing from `BLIND` [s] on; which one depends on the seed."""
    posts: float = 0.0
    """Posts a square metre, in the physics world [1/m²]."""
    clearance: float = 0.45
    """Distance of posts from the ways of the slots at least [m]; robots drive around what is nearer."""

    @property
    def mission(self) -> Mission:
        """The mission that agents have."""
        errors = self.errors._replace(beams=FINE_BEAMS) if self.drivers else self.errors
        scan = f'model = "{self.scanner}"' if self.scanner else "rate = 5"
        return seeing.hexagon(
            ROUTES[self.route], errors, measurement=self.measurement, team=self.team, scan=scan
        )


class Displaced(Fleet):
    """A fleet with robots that are not exactly on their start poses."""

    def __init__(
        self, of: Mission, errors: Errors, seed: int, weather: Weather, world: WorldName, driver: str = ""
    ) -> None:
        """With `driver`, the model of a scanner, scans are as its driver sends them."""
        self._real, self._driver = displaced(of, errors, seed), driver
        super().__init__(of, seed, weather, (), world)

    def _start_world(self, names: Sequence[str], seed: int, plants: Plants) -> None:
        made = rehearsed._in_physics(self._real, seed) if self.slips else plants
        super()._start_world(names, seed, lambda _, robots, number: made(self._real, robots, number))
        for name in names if self._driver else ():
            ranging = self.robots[name][0]._hosted[name].ranging
            if ranging is not None:
                seeing.send_as_driver(ranging, self._driver, seed)


def fleet_of(case: Case, seed: int) -> Displaced:
    """Return the fleet of a case."""
    driver, mission = case.scanner if case.drivers else "", case.mission
    if case.posts:
        real = displaced(mission, case.errors, seed)
        scattered = posts.scattered(mission, real, case.posts, case.clearance, seed)
        mission = mission.changed(simulation=mission.simulation.model_copy(update={"posts": scattered}))
    return Displaced(mission, case.errors, seed, case.weather, case.world, driver)


class Witness:
    """Compares what agents take for their neighbours with where these really are."""

    def __init__(self, fleet: Fleet) -> None:
        self.right = self.wrong = 0
        """Number of sightlines that were used, of the true neighbour and of something else."""
        self._fleet = fleet
        self._watched: set[int] = set()

    def watch(self) -> None:
        """Watch all agents, also those that have started since the last call."""
        for name, (agent, _) in self._fleet.agents.items():
            if agent.perception is not None and id(agent) not in self._watched:
                self._watched.add(id(agent))
                agent.perception._correct = self._noted(name, agent.perception)  # type: ignore[assignment,method-assign]

    def _noted(self, name: str, perception: Perception) -> Callable[[Expected, Detection], bool]:
        correct = perception._correct

        def noted(one: Expected, seen: Detection) -> bool:
            self._note(name, one, seen)
            return correct(one, seen)

        return noted

    def _note(self, name: str, one: Expected, seen: Detection) -> None:
        me, mate = self._place(name), self._place(one.candidate.name)
        centre = mate[0] + mate[1] * self._fleet.mission.robots[one.candidate.name].seen.at
        ray = one.axis * cmath.rect(seen.distance, seen.angle)
        off = abs(me[0] + me[1] * (one.scanner + ray) - centre)
        right = off < MAX_OFF + MAX_OFF_SHARE * seen.distance
        self.right += right
        self.wrong += not right

    def _place(self, name: str) -> tuple[complex, complex]:
        plant = self._fleet.robots[name][0].plant(name)
        return plant.position, plant.heading


class Error(NamedTuple):
    """Errors of the true relative positions over all edges, root mean square [m]."""

    shape: float
    """With the shape turned as fits best."""
    world: float
    """In the world frame."""
    believed: float
    """Of the positions that the agents publish, with their shape turned as fits best: without what the
    control law adds."""


def error(fleet: Fleet) -> Error:
    """The error now."""
    of, at, centre, believed = fleet.mission, {}, {}, {}
    for name, (world, _) in fleet.robots.items():
        plant = world.plant(name)
        plant.go_to(UPTIME + fleet.engine.now)
        centre[name], believed[name] = plant.position, fleet.agents[name][0].here.state.position
        at[name] = plant.position + of.robots[name].control_point_offset * plant.heading
    pairs = edges(of)
    true = [at[j] - at[i] for i, j in pairs]
    wanted = [of.slot(j) - of.slot(i) for i, j in pairs]
    return Error(
        misfit(true, wanted),
        rms(one - want for one, want in zip(true, wanted, strict=True)),
        misfit([centre[j] - centre[i] for i, j in pairs], [believed[j] - believed[i] for i, j in pairs]),
    )


class Sample(NamedTuple):
    """One second of a run."""

    time: float
    error: Error
    states: dict[str, str]
    locked: dict[str, bool]
    """Whether each robot with landmarks is locked."""


def run(case: Case, seed: int, seconds: float) -> tuple[list[Sample], Witness]:
    """Drive for so long, with one sample each second."""
    fleet, samples = fleet_of(case, seed), []
    witness = Witness(fleet)
    blinded = list(fleet.mission.followers)[1 + seed % (len(fleet.mission.followers) - 1)]
    for second in range(1, int(seconds) + 1):
        if case.blinds and second - 1 in BLIND:
            _lose_beams(fleet, blinded, 1.0 if second - 1 == BLIND[0] else case.errors.lost)
        fleet.engine.run(second - 1 + 0.25)
        witness.watch()
        fleet.engine.run(float(second))
        agents = {name: agent for name, (agent, _) in fleet.agents.items()}
        states = {name: str(agent.decision.state) for name, agent in agents.items()}
        sees = {name: agent.perception for name, agent in agents.items() if agent.perception is not None}
        locked = {name: one.state.locked for name, one in sees.items() if one.mates}
        samples.append(Sample(float(second), error(fleet), states, locked))
    return samples, witness


def _lose_beams(fleet: Fleet, name: str, share: float) -> None:
    ranging = fleet.robots[name][0]._hosted[name].ranging
    assert ranging is not None
    ranging._scanner = ranging._scanner._replace(lost=share)


def locked_after(samples: Sequence[Sample]) -> float | None:
    """When all robots with landmarks were locked for the first time [s]; None for never."""
    return next((one.time for one in samples if all(one.locked.values())), None)


def window(samples: Sequence[Sample], begin: float, end: float) -> Error:
    """RMS over a time [s]."""
    inside = [one.error for one in samples if begin < one.time <= end]
    return Error(*(rms(complex(one) for one in column) for column in zip(*inside, strict=True)))
