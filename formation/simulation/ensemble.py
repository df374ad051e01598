"""Many runs of one mission at once: the closed loop of N robots, without a network.

The law, observer, tracks and kinematics are the ones that agents use; only the links and the bodies are
simulated (`formation.simulation.loop`). Shapes: R runs, N robots (leader first), F = N-1 followers, E edges
of the graph. Bodies pass through each other, which is counted, and all act at the same instants. Positions
are in the frame of each robot's odometry, as are those that robots publish: drift moves the robot in it, for
neither the law nor the formation error can see more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation.arrays import ComplexArray, FloatArray
from formation.avoidance import SHARPER
from formation.edges import Edges
from formation.figure import Figure
from formation.law import LAWS, Law, Limits
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS, longest_way
from formation.quantiser import Grid, Quantiser
from formation.robot_spec import RobotSpec
from formation.route import Route
from formation.simulation import loop
from formation.simulation.body import Body
from formation.simulation.compiled import AVAILABLE, compiled
from formation.simulation.leader import positions
from formation.simulation.links import TRACK
from formation.simulation.minding import minds_in, minds_of
from formation.simulation.records import EDGE, FOLLOWER, ROBOT
from formation.simulation.starts import Starts
from formation.unicycle import Command

Observer = Literal["innovation", "mended", "printed"]
"""Field law's; Eq. (3) with erratum 1 mended; Eq. (3) as printed."""
_OBSERVERS = {"innovation": loop.INNOVATION, "mended": loop.MENDED, "printed": loop.PRINTED}


@dataclass(frozen=True, slots=True)
class Options:
    """What a simulation may do differently from the mission, and from a perfect network."""

    delay: float = 0.0
    """Age of every neighbour's sample when it is used [s]; rounded up to whole steps."""
    loss: float = 0.0
    """Share of neighbours' samples that never arrive, each edge for itself, in [0, 1]."""
    body: Body | None = None
    """Drive and odometry of every robot; by default the mission's [simulated_robot]."""
    measurement: Literal["network", "local"] | None = None
    """Of every robot; by default what the mission says of each."""
    observer: Observer | None = None
    """By default the law's own: `innovation` for the field law, `mended` for the paper's."""
    avoid: bool = True
    """Whether robots get out of each other's way, if the mission has them do so."""
    normalised: bool = True
    """Whether ζ̂/|ζ̂| is used; False takes ζ̂ as it is, as Eq. (7) is printed."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.delay <= 60.0:
            raise ValueError(f"delay = {self.delay}: must be from 0 to 60 s")
        if not 0.0 <= self.loss <= 1.0:
            raise ValueError(f"loss = {self.loss}: must be a share from 0 to 1")

    def delay_steps(self, step: float) -> int:
        """The delay in steps of so many seconds."""
        return int(np.ceil(self.delay / step - 1e-9))


class Plan(NamedTuple):
    """What is to be written down on the way."""

    steps: int
    """How many there will be."""
    stride: int
    """Steps between moments of the error that is kept for every run."""


class Ensemble:
    """R runs of a mission; `run_on` takes all of them some steps further."""

    def __init__(
        self,
        mission: Mission,
        law: str | Law,
        options: Options,
        starts: Starts,
        step: float,
        rng: np.random.Generator,
        plan: Plan,
    ) -> None:
        """`law` is a key of LAWS, or a law that gets what `field` does; `step` the control period [s]."""
        printed = law == "paper"
        observer = options.observer or ("mended" if printed else "innovation")
        self.steps = 0
        """Taken so far."""
        self.route = Route.of(mission)
        self._draw = rng
        avoids = options.avoid and not printed and mission.collisions.mode == "on"
        minds = avoids and any(mission.minded(name) for name in mission.followers)
        self._world = loop.World(
            step=step,
            gains=mission.law.gains,
            body=options.body or Body.of(mission.simulated_robot),
            observer=_OBSERVERS[observer],
            observer_gain=mission.law.observer_gain,
            course_gain=SHARPER * mission.law.observer_gain if minds else 0.0,
            noise=mission.collisions.noise,
            normalised=options.normalised,
            feed_forward=not printed and mission.law.feed_forward,
            carries=not printed and mission.law.delay_compensation,
            time_constant=0.0 if printed else mission.law.velocity_filter,
            loss=options.loss,
            quantises=any(Quantiser.of(*_steps(mission.robots[name])) for name in mission.followers),
            settled=mission.settled,
            stride=plan.stride,
        )
        self._robots, self._edges = _robots(mission, options, step), _edges(mission, options, step)
        self._followers = _followers(starts, self._world.body, rng)
        self._tracks = np.zeros((len(self._followers), len(self._edges)), TRACK)
        self._tracks["stamp"] = -np.inf
        ring = options.delay_steps(step) + 1
        self._said = np.zeros((len(self._followers), ring, len(mission.names)), dtype=np.complex128)
        late = options.delay_steps(step) * step
        self._minds = minds_in(
            mission, options.measurement, late, self._said.shape, starts.position, avoids=minds
        )
        guesses = [mission.first_heading(name) for name in mission.followers]
        self._followers["estimate"] = self._followers["course"] = guesses
        if observer != "innovation":
            self._followers["estimate"] = mission.law.observer_gain * self._followers["odometry"]
        chosen = LAWS[law] if isinstance(law, str) else law
        self._run_on = compiled(loop.run_on, law=chosen)
        self._all_run_on = compiled(loop.all_run_on, law=chosen)
        self.error: FloatArray = self._error_now()
        """Formation error of every run now [m], infinite where it has left the numbers; shape (R,)."""
        self.nearest: FloatArray = np.full(len(self.error), np.inf)
        """How near two bodies came [m], shape (R,): negative where they touched, infinite where off."""
        self.last_out = np.where(self.error >= mission.settled, 0, -1)
        """Step at which it was not under the mission's bound for the last time, -1 for never; shape (R,)."""
        self.errors: FloatArray = np.full((plan.steps // plan.stride + 1, len(self.error)), np.inf)
        """Formation error every `Plan.stride` steps [m]; shape (moments, R)."""
        self.errors[0] = self.error

    @property
    def time(self) -> float:
        """Since the start [s]."""
        return self.steps * self._world.step

    @property
    def followers(self) -> NDArray[Any]:
        """All of them, records of `records.FOLLOWER`; shape (R, F)."""
        return self._followers

    @property
    def robots(self) -> NDArray[Any]:
        """What followers are, records of `records.ROBOT`; shape (F,)."""
        return self._robots

    def run_on(self, steps: int) -> None:
        """Take so many steps. Random numbers are drawn run by run: how steps are grouped matters to them."""
        begin, leader = self.steps, self._leader(steps + 1)
        self.steps += steps
        if AVAILABLE:
            self._all_run_on(
                begin, leader, self._world, self._robots, self._edges, self._followers, self._tracks,
                self._said, self._draw, self.errors, self.last_out, self.error, self.nearest, self._minds,
            )  # fmt: skip
            return
        robots, edges = self._robots.view(np.recarray), self._edges.view(np.recarray)
        followers, tracks = self._followers.view(np.recarray), self._tracks.view(np.recarray)
        minds = self._minds._replace(
            whom=self._minds.whom.view(np.recarray),
            tracks=self._minds.tracks.view(np.recarray),
            around=self._minds.around.view(np.recarray),
        )
        for r in np.flatnonzero(np.isfinite(self.error)):
            one = (
                followers[r],
                tracks[r],
                self._said[r],
                self._draw,
                self.errors[:, r],
                minds_of(minds, int(r)),
            )
            try:
                out, self.error[r], room = self._run_on(begin, leader, self._world, robots, edges, *one)
            except (ArithmeticError, ValueError):  # Python's word for a run that leaves the numbers
                out, self.error[r], room = self.steps, np.inf, np.inf
            self.last_out[r] = max(self.last_out[r], out)
            self.nearest[r] = min(self.nearest[r], room)

    def _error_now(self) -> FloatArray:
        error, here = compiled(loop.formation_error), self._leader(1)[0]
        robots, edges = self._robots.view(np.recarray), self._edges.view(np.recarray)
        runs = self._followers.view(np.recarray)
        return np.array([error(run, robots, edges, here) for run in runs])

    def _leader(self, count: int) -> ComplexArray:
        """Where it is now and after each next step [m; world frame]."""
        return positions(
            self.route, self._world.step * np.arange(self.steps, self.steps + count, dtype=np.float64)
        )


def _steps(robot: RobotSpec) -> tuple[Command, Limits]:
    return Command(robot.speed_step, robot.turn_rate_step), robot.limits


def _robots(mission: Mission, options: Options, step: float) -> NDArray[Any]:
    robots = np.zeros(len(mission.followers), ROBOT)
    last, minds_end = 0, 0
    for i, name in enumerate(mission.followers):
        spec = mission.robots[name]
        first, last = last, last + len(spec.neighbours)
        minds, minds_end = minds_end, minds_end + len(mission.minded(name))
        speed = Grid.of(spec.speed_step, spec.max_speed)
        turn_rate = Grid.of(spec.turn_rate_step, spec.max_turn_rate)
        local = (options.measurement or spec.measurement) == "local"
        steps = speed.step, speed.most, turn_rate.step, turn_rate.most
        body = spec.radius, max(spec.longest_command, step), minds, minds_end
        robots[i] = (*spec.limits, *steps, first, last, local, *body)
    return robots


def _edges(mission: Mission, options: Options, step: float) -> NDArray[Any]:
    graph = Edges(mission.graph)
    robots = [mission.robots[name] for name in mission.names]
    local = np.array([(options.measurement or robot.measurement) == "local" for robot in robots])
    edges = np.zeros(len(graph.heads), EDGE)
    slots = np.array(Figure.first(mission).slots(mission))
    edges["head"], edges["desired"] = graph.heads, graph.along_edges(slots)
    edges["late"] = np.where(local[graph.tails], 0.0, options.delay_steps(step) * step)
    edges["limit"] = np.array([FRESH_PERIODS / robot.rate for robot in robots])[graph.heads]
    edges["longest_way"] = np.array([longest_way(robot.rate) for robot in robots])[graph.heads]
    edges["top_speed"] = np.array([robot.top_speed for robot in robots])[graph.heads]
    return edges


def _followers(starts: Starts, body: Body, rng: np.random.Generator) -> NDArray[Any]:
    followers = np.zeros(starts.position.shape, FOLLOWER)
    followers["position"], followers["heading"] = starts
    followers["odometry"] = starts.position
    followers["drift"] = body.drift * np.exp(1j * rng.uniform(-np.pi, np.pi, followers.shape))
    if body.position_noise > 0.0:
        x, y = rng.normal(0.0, body.position_noise, (2, *followers.shape))
        followers["odometry"] += x + 1j * y
    return followers
