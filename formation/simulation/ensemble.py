"""Many runs of one mission at once: the closed loop of N robots, without a network.

The law, observer, tracks and kinematics are the ones that agents use; only the links and the bodies are
simulated (`formation.simulation.closed_loop`). Shapes: R runs, N robots (leader first), F = N-1 followers,
E edges of the graph. Bodies pass through each other, which is counted, and all act at the same instants.
Positions are in the frame of each robot's odometry, as are those that robots publish: drift moves the
robot in it, because neither the law nor the formation error depends on more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from formation.control.arrays import ComplexArray, FloatArray
from formation.control.avoidance import HEADING_GAIN_RATIO
from formation.control.controller import Controller
from formation.control.observer import Observer
from formation.control.pose_filter import first_spread, least_noise
from formation.control.tracker import FRESH_PERIODS, longest_delay
from formation.control.unicycle import along
from formation.mission.model import Mission
from formation.mission.route import Route
from formation.simulation import closed_loop as loop
from formation.simulation.body import Body
from formation.simulation.compiled import AVAILABLE, compiled, naming_law
from formation.simulation.edges import Edges
from formation.simulation.neighbours import TRACK, avoided_in, avoided_of
from formation.slots.shape import PlacedShape

ROBOT = np.dtype(
    [
        ("offset", "f8"), ("max_speed", "f8"), ("max_turn_rate", "f8"), ("acceleration", "f8"),
        ("speed_step", "f8"), ("speed_most", "f8"), ("turn_rate_step", "f8"), ("turn_rate_most", "f8"),
        ("first", "i8"), ("last", "i8"),
        ("local", "b1"), ("slot", "c16"),
        ("radius", "f8"), ("hold", "f8"), ("lag", "f8"), ("avoided", "i8"), ("avoided_end", "i8"),
        ("ramp_time", "f8"), ("ramp_longest", "f8"), ("ramp_gap", "f8"), ("ramp_gentle", "f8"),
    ],
    align=True,
)  # fmt: skip
"""Constants of a follower: limits, `Grid` of both numbers, its edges, whether it has a sensor of its own,
its slot; its body, the longest time that a command may last, its lag, indices of its obstacles;
`RampLimits`."""
EDGE = np.dtype(
    [
        ("head", "i8"), ("desired", "c16"),
        ("late", "f8"), ("limit", "f8"), ("longest_delay", "f8"), ("top_speed", "f8"),
    ],
    align=True,
)  # fmt: skip
"""An edge: index of the neighbour, z*_ij [m; world frame], `Link`."""
FOLLOWER = np.dtype(
    [
        ("position", "c16"), ("heading", "c16"),
        ("odometry", "c16"), ("estimate", "c16"), ("facing", "c16"), ("integral", "c16"),
        ("believed", "c16"), ("position_variance", "f8"), ("cross_variance", "c16"),
        ("heading_variance", "f8"), ("noise_variance", "f8"), ("innovation", "c16"),
        ("speed", "f8"), ("turn_rate", "f8"), ("wanted_speed", "f8"), ("wanted_turn_rate", "f8"),
        ("wheel_speed", "f8"), ("wheel_turn_rate", "f8"), ("owed_speed", "f8"), ("owed_turn_rate", "f8"),
        ("ramped_speed", "f8"), ("ramped_turn_rate", "f8"), ("commanded", "f8"), ("gentle_until", "f8"),
        ("drift", "c16"),
        ("course", "c16"), ("travelled", "f8"), ("kept", "f8"), ("detour", "f8"),
        ("deadlocks", "i8"), ("went", "c16"), ("side", "f8"), ("slow", "f8"),
    ],
    align=True,
)  # fmt: skip
"""State of a follower: pose without noise; its measurements and estimates; filtered position and `Spread`
of the pose filter; mean motion over the last step,
the command, the wheels at its end, remainder of the quantiser; `Ramp`; direction of its odometry's drift,
a share of the path; the filter's own estimate of the heading, its path length, `Avoidance`."""
_SPREAD = ("position_variance", "cross_variance", "heading_variance", "noise_variance", "innovation")
MIN_START_CLEARANCE = 0.05
"""Least distance between the bodies at random starts [m]."""
MAX_TRIES = 100
"""Number of tries for a start that is far enough from others; then it stays."""


class Starts(NamedTuple):
    """Initial poses of followers; shapes (R, F)."""

    position: ComplexArray
    """Centres [m; world frame]."""
    heading: ComplexArray
    """Unit complex [world frame]."""


@dataclass(frozen=True, slots=True)
class Options:
    """Differences of a simulation from the mission, and from a perfect network."""

    delay: float = 0.0
    """Age of every neighbour's sample when it is used [s]; rounded up to whole steps."""
    loss: float = 0.0
    """Share of neighbours' samples that never arrive, independently for each edge, in [0, 1]."""
    body: Body | None = None
    """Drive and odometry of every robot; by default the mission's [simulated_robot]."""
    measurement: Literal["network", "local"] | None = None
    """Measurement of every robot; by default as the mission says."""
    observer: Observer | None = None
    """Heading observer, without pose filter; by default what the law uses."""
    avoid: bool = True
    """Whether robots avoid each other, if the mission says so."""
    normalised: bool = True
    """Whether ζ̂/|ζ̂| is used; False uses ζ̂ itself, as Eq. (7) is printed."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.delay <= 60.0:
            raise ValueError(f"delay = {self.delay}: must be from 0 to 60 s")
        if not 0.0 <= self.loss <= 1.0:
            raise ValueError(f"loss = {self.loss}: must be a share from 0 to 1")

    def delay_steps(self, step: float) -> int:
        """The delay in steps of that many seconds."""
        return int(np.ceil(self.delay / step - 1e-9))


class Ensemble:
    """R runs of a mission; `run_on` advances all of them."""

    def __init__(
        self,
        mission: Mission,
        controller: Controller,
        options: Options,
        starts: Starts,
        step: float,
        rng: np.random.Generator,
        steps: int,
        stride: int,
    ) -> None:
        """`step` is the control period [s]; of `steps` steps every `stride`-th error is stored."""
        law, observer = mission.law, options.observer or controller.observer
        self.steps = 0
        """Taken so far."""
        self.route = Route.of(mission)
        self._draw = rng
        avoids = options.avoid and controller.collision_filter and mission.collisions.mode == "on"
        velocities = controller.feed_forward or controller.delay_compensation or controller.collision_filter
        avoids = avoids and any(mission.avoided_by(name) for name in mission.followers)
        self._world = loop.World(
            step=step,
            gains=mission.gains_for(controller),
            body=options.body or Body.of(mission.simulated_robot),
            observer_gain=law.observer_gain,
            course_gain=HEADING_GAIN_RATIO * law.observer_gain if avoids else 0.0,
            noise=mission.collisions.noise,
            filters_pose=controller.pose_filter and options.observer is None,
            least_noise=least_noise(mission.collisions.noise),
            normalised=options.normalised,
            feed_forward=controller.feed_forward and law.feed_forward,
            carries=controller.delay_compensation and law.delay_compensation,
            mean=controller.mean,
            leader_speed=mission.leader_speed,
            ordered_velocity=controller.mean and law.leader_orders in {"velocity", "place"},
            ordered_place=controller.mean and law.leader_orders == "place",
            time_constant=law.velocity_filter if velocities else 0.0,
            loss=options.loss,
            settled=mission.settled,
            stride=stride,
        )
        self.robots = _robots(mission, controller, options, step)
        """Constants of the followers, records of `ROBOT`; shape (F,)."""
        self._edges = _edges(mission, options, step)
        self.followers = _followers(starts, self._world.body, rng)
        """All of them, records of `FOLLOWER`; shape (R, F)."""
        self.followers["believed"] = self.followers["odometry"]
        spread = first_spread(self._world.least_noise)
        for name, value in zip(_SPREAD, spread, strict=True):
            self.followers[name] = value
        self.followers["commanded"] = -step  # zero velocity, as until then
        self.followers["gentle_until"] = -np.inf
        self._tracks = np.zeros((len(self.followers), len(self._edges)), TRACK)
        self._tracks["stamp"] = -np.inf
        ring = options.delay_steps(step) + 1
        self._published = np.zeros((len(self.followers), ring, len(mission.names)), dtype=np.complex128)
        late = options.delay_steps(step) * step
        self._avoided = avoided_in(
            mission, options.measurement, late, self._published.shape, starts.position, avoids=avoids
        )
        guesses = [mission.first_heading(name) for name in mission.followers]
        self.followers["estimate"] = self.followers["course"] = guesses
        if observer.start is not None:
            centres: Any = self.followers["odometry"]
            self.followers["estimate"] = observer.start(centres, law.observer_gain)
        self._law = controller.name
        self._run_on = compiled(loop.run_on, law=controller.step, observe=observer.step)
        self._all_run_on = compiled(loop.all_run_on, law=controller.step, observe=observer.step)
        self.error: FloatArray = self._error_now()
        """Formation error of every run now [m], infinite if it has overflowed; shape (R,)."""
        self.nearest: FloatArray = np.full(len(self.error), np.inf)
        """Least distance between two bodies [m], shape (R,): negative if they touched, infinite if not
        detected."""
        self.last_out = np.where(self.error >= mission.settled, 0, -1)
        """Last step at which it was not under the mission's bound, -1 for never; shape (R,)."""
        self.errors: FloatArray = np.full((steps // stride + 1, len(self.error)), np.inf)
        """Formation error every `stride` steps [m]; shape (moments, R)."""
        self.errors[0] = self.error

    @property
    def time(self) -> float:
        """Since the start [s]."""
        return self.steps * self._world.step

    def run_on(self, steps: int) -> None:
        """Take that many steps. Random numbers are drawn run by run, in an order that depends on `steps`."""
        begin, leader = self.steps, self._leader(steps + 1)
        ordered = velocities(self.route, self._times(steps))
        self.steps += steps
        if AVAILABLE:
            with naming_law(self._law):
                self._all_run_on(
                    begin, leader, ordered, self._world, self.robots, self._edges, self.followers,
                    self._tracks, self._published, self._draw, self.errors, self.last_out, self.error,
                    self.nearest, self._avoided,
                )  # fmt: skip
            return
        robots, edges = self.robots.view(np.recarray), self._edges.view(np.recarray)
        followers, tracks = self.followers.view(np.recarray), self._tracks.view(np.recarray)
        avoided = self._avoided._replace(
            whom=self._avoided.whom.view(np.recarray),
            tracks=self._avoided.tracks.view(np.recarray),
            around=self._avoided.around.view(np.recarray),
        )
        for r in np.flatnonzero(np.isfinite(self.error)):
            try:
                out, self.error[r], room = self._run_on(
                    begin, leader, ordered, self._world, robots, edges, followers[r], tracks[r],
                    self._published[r], self._draw, self.errors[:, r], avoided_of(avoided, int(r)),
                )  # fmt: skip
            except (ArithmeticError, ValueError):  # raised by Python for a run that overflows
                out, self.error[r], room = self.steps, np.inf, np.inf
            self.last_out[r] = max(self.last_out[r], out)
            self.nearest[r] = min(self.nearest[r], room)

    def _error_now(self) -> FloatArray:
        error, here = compiled(loop.formation_error), self._leader(1)[0]
        robots, edges = self.robots.view(np.recarray), self._edges.view(np.recarray)
        runs = self.followers.view(np.recarray)
        return np.array([error(run, robots, edges, here) for run in runs])

    def _leader(self, count: int) -> ComplexArray:
        """Its positions now and after each next step [m; world frame]."""
        return positions(self.route, self._times(count))

    def _times(self, count: int) -> FloatArray:
        """The moments of the next steps, the first of them now [s]."""
        return self._world.step * np.arange(self.steps, self.steps + count, dtype=np.float64)


def own_starts(mission: Mission, runs: int) -> Starts:
    """The starts of the mission itself, the same in every run."""
    starts = [mission.robots[name].start for name in mission.followers]
    position = np.array([start.position for start in starts], dtype=np.complex128)
    heading = np.array([start.heading for start in starts], dtype=np.complex128)
    return Starts(np.tile(position, (runs, 1)), np.tile(heading, (runs, 1)))


def random_starts(mission: Mission, runs: int, spread: float, rng: np.random.Generator) -> Starts:
    """Control points uniformly within ± `spread` [m] of their slots on each axis, headings uniformly.

    If two bodies would overlap the later one of them is drawn again.
    """
    shape = (runs, len(mission.followers))
    heading = np.exp(1j * rng.uniform(-np.pi, np.pi, shape))
    away = rng.uniform(-spread, spread, shape) + 1j * rng.uniform(-spread, spread, shape)
    offset = np.array([mission.robots[name].control_point_offset for name in mission.followers])
    slots = mission.robots[mission.leader].start.position + np.array(
        PlacedShape.first(mission).slots(mission)[1:]
    )
    position = slots + away - offset * heading
    radii = np.array([mission.robots[name].radius for name in mission.followers])
    for j in range(1, len(radii)):
        for _ in range(MAX_TRIES):
            distance = np.abs(position[:, :j] - position[:, j : j + 1])
            crowded = np.flatnonzero((distance < radii[:j] + radii[j] + MIN_START_CLEARANCE).any(axis=1))
            if not len(crowded):
                break
            again = rng.uniform(-spread, spread, (2, len(crowded)))
            position[crowded, j] = slots[j] + again[0] + 1j * again[1] - offset[j] * heading[crowded, j]
    return Starts(position, heading)


def positions(route: Route, times: FloatArray) -> ComplexArray:
    """Control points [m; world frame] at `times` [s since the start], which ascend; of their shape."""
    arcs = route.arcs
    starts = np.array(route.begins)
    position = np.array([arc.position for arc in arcs], dtype=np.complex128)
    heading = np.array([arc.heading for arc in arcs], dtype=np.complex128)
    speed = np.array([arc.speed for arc in arcs])
    turn_rate = np.array([arc.turn_rate for arc in arcs])
    found = np.empty(len(times), dtype=np.complex128)
    compiled(_fill)(found, times, starts, position, heading, speed, turn_rate)
    return found


def velocities(route: Route, times: FloatArray) -> ComplexArray:
    """The leader's velocities [m/s; world frame] from `times` [s since the start] on; of their shape."""
    last = np.searchsorted(route.begins, times, side="right") - 1
    heading = np.array([arc.heading for arc in route.arcs], dtype=np.complex128)[last]
    speed, turn_rate = (
        np.array([getattr(arc, key) for arc in route.arcs])[last] for key in ("speed", "turn_rate")
    )
    turned = turn_rate * (times - np.array(route.begins)[last])
    return np.asarray(speed * heading * np.exp(1j * turned), dtype=np.complex128)


def _robots(mission: Mission, controller: Controller, options: Options, step: float) -> NDArray[Any]:
    robots = np.zeros(len(mission.followers), ROBOT)
    last, avoided_end = 0, 0
    for i, name in enumerate(mission.followers):
        spec, params = mission.robots[name], mission.control(name, controller, step)
        first, last = last, last + len(spec.neighbours)
        avoided, avoided_end = avoided_end, avoided_end + len(mission.avoided_by(name))
        speed, turn_rate = params.quantiser
        local = (options.measurement or spec.measurement) == "local"
        steps = speed.step, speed.most, turn_rate.step, turn_rate.most
        filtered = params.avoidance
        body = filtered.radius, filtered.hold, filtered.lag, avoided, avoided_end
        slot = PlacedShape.first(mission).slot(mission, name)
        robots[i] = (*params.limits[:4], *steps, first, last, local, slot, *body, *params.ramp)
    return robots


def _edges(mission: Mission, options: Options, step: float) -> NDArray[Any]:
    graph = Edges(mission.graph)
    robots = [mission.robots[name] for name in mission.names]
    local = np.array([(options.measurement or robot.measurement) == "local" for robot in robots])
    edges = np.zeros(len(graph.heads), EDGE)
    slots = np.array(PlacedShape.first(mission).slots(mission))
    edges["head"], edges["desired"] = graph.heads, graph.along_edges(slots)
    edges["late"] = np.where(local[graph.tails], 0.0, options.delay_steps(step) * step)
    edges["limit"] = np.array([FRESH_PERIODS / robot.rate for robot in robots])[graph.heads]
    edges["longest_delay"] = np.array([longest_delay(robot.rate) for robot in robots])[graph.heads]
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


def _fill(
    found: Any, times: Any, starts: Any, position: Any, heading: Any, speed: Any, turn_rate: Any
) -> None:
    arc = 0
    for k in range(len(times)):
        while arc + 1 < len(starts) and starts[arc + 1] <= times[k]:
            arc += 1
        elapsed = max(times[k] - starts[arc], 0.0)
        found[k], _ = along(position[arc], heading[arc], speed[arc] * elapsed, turn_rate[arc] * elapsed)
