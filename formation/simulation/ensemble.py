"""Many runs of one mission at once: the closed loop of N robots, as arrays, without a network.

The law, observer, tracks and kinematics are the ones that agents use; only the links and the bodies are
simulated. Shapes: R runs, N robots (leader first), F = N-1 followers, E edges of the graph. Robots do not
collide, and all act at the same instants. Positions are in the frame of each robot's odometry, as are those
that robots publish: drift moves the robot in it, for neither the law nor the formation error can see more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from formation import heading as observers
from formation.heading import Travel
from formation.law import LAWS, Law, Limits, Measured
from formation.mission import Mission
from formation.neighbour import FRESH_PERIODS
from formation.plane import ComplexArray, rotation, unit
from formation.quantiser import Quantiser
from formation.robot_spec import RobotSpec
from formation.route import Route
from formation.simulation.body import Body
from formation.simulation.links import Heard, Links, Mask, Terms
from formation.simulation.starts import Starts
from formation.unicycle import Command, advance, control_point

AHEAD = 1000
"""Steps for which the leader's route is evaluated at once."""
Observer = Literal["innovation", "mended", "printed"]
"""Field law's; Eq. (3) with erratum 1 mended; Eq. (3) as printed."""


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
    normalised: bool = True
    """Whether ζ̂/|ζ̂| is used; False takes ζ̂ as it is, as Eq. (7) is printed."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.delay <= 60.0:
            raise ValueError(f"delay = {self.delay}: must be from 0 to 60 s")
        if not 0.0 <= self.loss <= 1.0:
            raise ValueError(f"loss = {self.loss}: must be a share from 0 to 1")


class Ensemble:
    """R runs of a mission; `step` takes all of them one step further."""

    def __init__(
        self,
        mission: Mission,
        law: str | Law,
        options: Options,
        starts: Starts,
        step: float,
        rng: np.random.Generator,
    ) -> None:
        """`law` is a key of LAWS, or a law that gets what `field` does; `step` the control period [s]."""
        robots = [mission.robots[name] for name in mission.followers]
        self.steps = 0
        """Taken so far."""
        self.position, self.heading = starts
        """Pose of every follower without noise; shapes (R, F)."""
        self.limits = Limits(
            np.array([robot.control_point_offset for robot in robots]),
            np.array([robot.max_speed for robot in robots]),
            np.array([robot.max_turn_rate for robot in robots]),
        )
        """Of every follower; shapes (F,)."""
        at_rest = np.zeros(self.position.shape)
        self.moving = Command(at_rest, at_rest)
        """What the bodies did, on average over the last step."""
        self._wheels = self.moving
        self._quantiser = Quantiser.of(_steps(robots), self.limits)
        self._remainder = self.moving
        self._mission, self._graph, self.route = mission, mission.graph, Route.of(mission)
        self._law = LAWS[law] if isinstance(law, str) else law
        self._gains, self._dt, self._rng = mission.law.gains, step, rng
        self._body = options.body or Body.of(mission.simulated_robot)
        self._observer: Observer = options.observer or ("mended" if law == "paper" else "innovation")
        self._normalised = options.normalised
        self._feed_forward = law != "paper" and mission.law.feed_forward
        self._desired = self._graph.along_edges(mission.slots())
        self._all_desired = self._graph.sum_per_follower(self._desired)
        self._leader: ComplexArray = np.empty(0, dtype=np.complex128)
        self._local = np.array([(options.measurement or r.measurement) == "local" for r in robots])
        self._follower = self._graph.tails - 1
        self._links = Links(self._graph, _terms(mission, law, options, self._local, step), rng)
        self._integral = np.zeros_like(self.position)
        self._travel: Travel | None = None
        self._bias = self._body.drift * rotation(rng.uniform(-np.pi, np.pi, self.position.shape))
        self._odometry = self._localise()
        self.estimate: ComplexArray = self._first_estimate()
        """Estimated headings, not always of unit length; shape (R, F)."""

    @property
    def time(self) -> float:
        """Since the start [s]."""
        return self.steps * self._dt

    @property
    def points(self) -> ComplexArray:
        """Control points of all robots without noise, the leader's first [m; world frame]; shape (R, N)."""
        return self._with_leader(control_point(self.position, self.heading, self.limits.offset))

    def step(self) -> None:
        """Measure, estimate, hear the neighbours, apply the law, and move for one step."""
        if self._travel is not None:
            last, self._odometry = self._odometry, self._localise()
            self._observe(self._travel._replace(displacement=self._odometry - last))
        heading = unit(self.estimate) if self._normalised else self.estimate
        point = control_point(self._odometry, heading, self.limits.offset)
        sensed = self._sense() if self._local.any() else None
        seen_at = None
        if sensed is not None:
            seen_at = point[:, self._follower] + heading[:, self._follower] * sensed
        heard = self._links.hear(self.time, self._with_leader(point), seen_at)
        measured, blind = self._measured(heard, heading, point, sensed)
        before = self._integral
        command, self._integral = self._law(before, heading, measured, self._gains, self.limits, self._dt)
        if blind is not None:  # nobody to follow: stand still, and learn nothing
            command = Command(*(np.where(blind, 0.0, wanted) for wanted in command))
            self._integral = np.where(blind, before, self._integral)
        if self._quantiser is not None:
            command, self._remainder = self._quantiser.quantise(command, self._remainder)
        self._move(command)

    def _measured(
        self, heard: Heard, heading: ComplexArray, point: ComplexArray, sensed: ComplexArray | None
    ) -> tuple[Measured, Mask | None]:
        """The law's input, and which followers have nobody to follow (None where all have)."""
        total, velocity = self._graph.sum_per_follower, heard.velocity
        displacement = heard.point - point[:, self._follower]
        count, desired, blind = self._graph.degrees, self._all_desired, None
        if heard.fresh is not None:
            displacement = np.where(heard.fresh, displacement, 0.0)
            velocity = np.where(heard.fresh, velocity, 0.0)
            desired = total(np.where(heard.fresh, self._desired, 0.0))
            heard_of = total(heard.fresh.astype(np.float64))
            blind, count = heard_of == 0.0, np.maximum(heard_of, 1.0)
        relative = heading.conjugate() * total(displacement)
        if sensed is not None:
            relative = np.where(self._local, total(sensed), relative)
        forward = total(velocity) / count if self._feed_forward else 0.0
        return Measured(relative, desired, count, forward), blind

    def _sense(self) -> ComplexArray:
        """z_ij^(i) as a perfect sensor on robot i has it [m; body frame]; shape (R, E)."""
        seen_by = self.heading[:, self._follower]
        sensed: ComplexArray = seen_by.conjugate() * self._graph.along_edges(self.points)
        return sensed

    def _first_estimate(self) -> ComplexArray:
        if self._observer == "innovation":
            guesses = [self._mission.first_heading(name) for name in self._mission.followers]
            return np.tile(np.array(guesses, dtype=np.complex128), (self.position.shape[0], 1))
        return observers.printed_start(self._odometry, self._mission.law.observer_gain)

    def _observe(self, travel: Travel) -> None:
        gain = self._mission.law.observer_gain
        if self._observer == "innovation":
            self.estimate = observers.innovation(self.estimate, travel, gain)
        else:
            decay: Literal["speed", "turn rate"] = "speed" if self._observer == "mended" else "turn rate"
            self.estimate = observers.printed(self.estimate, travel, gain, decay)

    def _localise(self) -> ComplexArray:
        """Centres as the odometry has them [m; world frame]."""
        if self._body.position_noise <= 0.0:
            return self.position
        noise = self._rng.normal(0.0, self._body.position_noise, (2, *self.position.shape))
        noisy: ComplexArray = self.position + noise[0] + 1j * noise[1]
        return noisy

    def _move(self, command: Command) -> None:
        self.moving, self._wheels = self._body.drive(self._wheels, self._body.obeyed(command), self._dt)
        self._travel = Travel(self.moving.speed * self._dt, self.moving.turn_rate * self._dt, None)
        drifted = self._bias * np.abs(self._travel.distance) * self.heading if self._body.drift > 0.0 else 0.0
        self.position, self.heading = advance(self.position, self.heading, *self.moving, self._dt)
        self.position = self.position + drifted
        self.steps += 1

    def _leader_now(self) -> complex:
        """The leader's position now; its route is evaluated a thousand steps at a time."""
        place = self.steps % AHEAD
        if place == 0 or not len(self._leader):
            times = self._dt * (self.steps - place + np.arange(AHEAD))
            self._leader = self.route.position(times)
        return complex(self._leader[place])

    def _with_leader(self, followers: ComplexArray) -> ComplexArray:
        """Points of all robots from those of the followers; the leader's is its position."""
        points = np.empty((followers.shape[0], followers.shape[1] + 1), dtype=np.complex128)
        points[:, 0] = self._leader_now()
        points[:, 1:] = followers
        return points


def _steps(robots: Sequence[RobotSpec]) -> Command:
    return Command(
        np.array([robot.speed_step for robot in robots]), np.array([robot.turn_rate_step for robot in robots])
    )


def _terms(mission: Mission, law: str | Law, options: Options, local: Mask, step: float) -> Terms:
    graph = mission.graph
    robots = [mission.robots[name] for name in mission.names]
    field = law != "paper"
    return Terms(
        step=step,
        delay=int(np.ceil(options.delay / step - 1e-9)),
        loss=options.loss,
        limit=np.array([FRESH_PERIODS / robot.rate for robot in robots])[graph.heads],
        top_speed=np.array([robot.top_speed for robot in robots])[graph.heads],
        time_constant=mission.law.velocity_filter if field else None,
        carry=field and mission.law.delay_compensation,
        local=local[graph.tails - 1],
    )
