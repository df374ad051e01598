"""Simulated robots on the wire: commands in, odometry, ground truth and local measurements out.

A robot with external poses gets these as well, at the rate of its odometry.
One with a range scanner sees posts, walls and the robots of its own process. They obstruct only robots
with mass (`formation.agent.simulated.physics`).

`World.step(now, inbox) -> outbox` hosts one robot or many, without a clock, a socket or a log. A robot
moves by the time that has really passed, and a command takes effect when it arrived, so neither depends on
when the world is stepped. As on a TurtleBot3 nothing times out: the last command lasts for ever.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar, cast

import numpy as np

from formation.agent.simulated.plant import Moving, Plant
from formation.control.plane import angle_between, rotation
from formation.control.tracker import Track, carried_to, first_seen, seen
from formation.control.unicycle import Command, control_point
from formation.mission.model import Mission
from formation.ros2.messages import (
    Displacement,
    LaserScan,
    MapPose,
    Odometry,
    Pose,
    Twist,
    TwistStamped,
    decode,
    encode,
)
from formation.ros2.ros_names import address
from formation.sensing import raycast
from formation.simulation.body import Body
from formation.topics import AMCL_POSE, CMD_VEL, GROUND_TRUTH, ODOM, POSE, POSITION, RELATIVE, SCAN, Topic
from formation.transport.runtime.loop import Pauses, Runtime
from formation.transport.runtime.rate import TICK_TOLERANCE, Rate
from formation.wire import BadMessage, Now, Outgoing, Sample

_log = logging.getLogger(__name__)
Measurement = TypeVar("Measurement")
VISIBILITY_TIME = 0.5
"""Silence after which a leader is invisible to every sensor [s]."""
SECTORS = 10
"""Steps in which a scanner of a known model measures the beams of a turn."""
VELOCITY_FILTER_TIME = 0.01
"""Time constant of the leader's velocity between its positions [s]; they have no noise."""
UPDATE_DISTANCE, UPDATE_ANGLE = 0.25, 0.2
"""Motion of a robot after which AMCL publishes, by default [m; rad]."""
SCAN_TO_POSE_TIME = 0.15
"""Time from a scan to the pose that is computed from it [s]."""
POSE_DEVIATION, HEADING_DEVIATION = 0.02, 0.02
"""Standard deviations of a localiser's poses, per axis [m; rad]."""


def kinematic(mission: Mission, robots: Sequence[str], seed: int) -> dict[str, Plant]:
    """Return robots that move by Eq. (1). Their noise does not depend on which others are hosted."""
    body = Body.of(mission.simulated_robot)
    plants = {}
    for name in robots:
        spec, noise = mission.robots[name], np.random.default_rng([seed, mission.names.index(name)])
        from_start = spec.odometry_frame != "world"
        plants[name] = Plant(
            body, spec.start.position, spec.start.heading, noise, counts_from_here=from_start
        )
    return plants


class World:
    """Every robot that one process hosts."""

    def __init__(
        self,
        mission: Mission,
        robots: Iterable[str] | None = None,
        seed: int = 0,
        plants: Callable[[Mission, Sequence[str], int], Mapping[str, Moving]] = kinematic,
    ) -> None:
        """`robots` are followers, by default all. Raises ValueError for what cannot be simulated here.

        `plants` makes their bodies, from the mission, their names, and the seed of all noise.
        """
        names = mission.followers if robots is None else tuple(dict.fromkeys(robots))
        _check(mission, names)
        self.robots = names
        self.dropped: Counter[str] = Counter()
        """Messages that were not used, by key."""
        self._leader = mission.leader
        self._leader_track: Track | None = None
        self._top_speed = max(1e-3, *(leg.speed for leg in mission.route))
        moving = plants(mission, names, seed)
        self._hosted = {
            name: _Robot(mission, name, moving[name], seed, phase=number / len(names))
            for number, name in enumerate(names)
        }
        self._by_key = {CMD_VEL.key(name): robot for name, robot in self._hosted.items()}
        self._sees_leader = any(mission.leader in robot.sees for robot in self._hosted.values())
        self._due = -math.inf

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key that these robots publish."""
        own = [(topic, topic.key(name)) for name in self.robots for topic in (ODOM, GROUND_TRUTH)]
        sensors = [
            (RELATIVE, RELATIVE.key(name, other))
            for name, robot in self._hosted.items()
            for other in robot.sees
        ]
        maps = [(AMCL_POSE, AMCL_POSE.key(name)) for name, robot in self._hosted.items() if robot.localiser]
        cameras = [(POSE, POSE.key(name)) for name, robot in self._hosted.items() if robot.watched]
        scanners = [(SCAN, SCAN.key(name)) for name, robot in self._hosted.items() if robot.ranging]
        return (*own, *maps, *cameras, *scanners, *sensors)

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Every key that these robots subscribe to."""
        return (*self._by_key, *([POSITION.key(self._leader)] if self._sees_leader else []))

    @property
    def due(self) -> float:
        """When the next robot's message is due [s, monotonic]."""
        return self._due

    def plant(self, robot: str) -> Moving:
        """The body of a hosted robot, as of the last step."""
        return self._hosted[robot].plant

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Process commands; return odometry and all other messages of every robot that is due."""
        for sample in inbox:
            try:
                self._take(sample, now)
            except BadMessage:
                self.dropped[sample.key] += 1
        outbox: list[Outgoing] = []
        if now.mono - self._due < -TICK_TOLERANCE:  # as after most commands
            return outbox
        for robot in self._hosted.values():
            if robot.ranging and robot.ranging.rate.tick(now.mono):
                outbox += self._scanned(robot, robot.ranging, now)
            if robot.rate.tick(now.mono):
                outbox += self._spoken(robot, now)
        self._due = min(rate.due for robot in self._hosted.values() for rate in robot.rates)
        return outbox

    def halt(self, now: Now, reason: str) -> list[Outgoing]:  # noqa: ARG002 - a core's signature
        """Return nothing: a robot that is switched off sends no last messages."""
        return []

    def _take(self, sample: Sample, now: Now) -> None:
        if self._sees_leader and sample.key == POSITION.key(self._leader):
            self._leader_track = self._followed(decode(Pose, sample.payload), now)
            return
        robot = self._by_key.get(sample.key)
        if robot is None:
            raise BadMessage("unknown key")
        command = robot.read(sample.payload)
        robot.go_to(min(sample.arrived, now.mono))
        robot.plant.obey(command)

    def _followed(self, leader: Pose, now: Now) -> Track:
        track = self._leader_track
        if abs(now.wall - leader.stamp) > VISIBILITY_TIME:
            raise BadMessage("not from now")
        if track is None or now.wall - track.stamp > VISIBILITY_TIME:
            return first_seen(leader.stamp, leader.position)
        if leader.stamp <= track.stamp:
            raise BadMessage("older than what came before")
        return seen(track, leader.stamp, leader.position, VELOCITY_FILTER_TIME, self._top_speed)

    def _spoken(self, robot: _Robot, now: Now) -> list[Outgoing]:
        """Return a robot's messages of one period. Sensors come first, as odometry triggers the agent."""
        robot.go_to(now.mono)
        disturbed = robot.plant.disturbed
        displacements = [
            Outgoing(
                RELATIVE.key(robot.name, other),
                encode(Displacement(now.wall, robot.measured("relative", other, seen_at))),
            )
            for other in robot.sees
            if (seen_at := self._displacement(robot, other, now)) is not None
        ]
        late = disturbed.surroundings_late.get("relative", 0.0)
        outbox = robot.reported(displacements, now.mono, late)
        plant = robot.plant
        stamp = now.wall + disturbed.restamped
        odometry = Odometry(stamp, *plant.odometry(), *plant.moving, frame=robot.odometry_frame)
        truth = Pose(now.wall, plant.position, plant.heading)
        reports = [Outgoing(ODOM.key(robot.name), encode(odometry))]
        if robot.localiser is not None:
            poses = robot.localiser.poses(now.wall, plant.position, plant.heading)
            outbox += [Outgoing(AMCL_POSE.key(robot.name), encode(one)) for one in poses]
        if robot.watched:
            reports.append(Outgoing(POSE.key(robot.name), encode(Pose(stamp, *plant.seen()))))
        outbox += robot.reported([] if disturbed.pauses else reports, now.mono, disturbed.late)
        outbox.append(Outgoing(GROUND_TRUTH.key(robot.name), encode(truth)))
        return outbox

    def _scanned(self, robot: _Robot, ranging: Ranging, now: Now) -> list[Outgoing]:
        for one in self._hosted.values():
            one.go_to(now.mono)
        others = [one.disc for one in self._hosted.values() if one is not robot]
        if not ranging.measure(robot.plant, others):
            return []
        stamp = now.wall - ranging.stamp_age
        scan = robot.measured("scan", robot.name, ranging.scan(stamp))
        out = Outgoing(SCAN.key(robot.name), encode(replace(scan, stamp=stamp)))
        return robot.reported([out], now.mono, robot.plant.disturbed.surroundings_late.get("scan", 0.0))

    def _displacement(self, robot: _Robot, other: str, now: Now) -> complex | None:
        """From `robot`'s control point to the other's [m; robot's frame]; None if it is out of sight."""
        if other == self._leader:
            track = self._leader_track
            if track is None or abs(now.wall - track.stamp) > VISIBILITY_TIME:
                return None
            there = carried_to(track, now.wall, VISIBILITY_TIME)
        else:
            self._hosted[other].go_to(now.mono)
            there = self._hosted[other].control_point
        return (there - robot.control_point) * robot.plant.heading.conjugate()


class Ranging:
    """One robot's scanner. Without a model a scan is of one moment: all its beams are measured at once.

    One of a known model turns: beams are measured in `SECTORS` steps, in the order of that model.
    Its systematic errors have the mission's size, and a sign that the noise's seed decides.
    """

    def __init__(self, mission: Mission, robot: str, noise: np.random.Generator, phase: float) -> None:
        """It publishes at the mission's rate, `phase` [periods] after others."""
        spec, errors = mission.robots[robot].scan, mission.simulated_scanner
        self._model, self._sectors = spec.scanner, 1 if spec.scanner is None else SECTORS
        self.rate = Rate(spec.rate * self._sectors, phase)
        """Of its steps."""
        self._turn_time = 1.0 / spec.rate
        self._angle_min = 0.0 if spec.scanner is None else spec.scanner.angle_min
        late = spec.scanner is None or spec.scanner.stamped_late
        self.stamp_age = 0.0 if late else self._turn_time
        """Age of a scan's stamp when its turn ends [s]."""
        self._mount, self._scanner = spec.mount, errors.scanner(spec)
        self._posts = tuple(post.disc for post in mission.simulation.posts)
        self._walls = tuple(wall.line for wall in mission.simulation.walls)
        self._noise = noise
        self._true = [math.inf] * self._scanner.beams  # newest distance of each beam [m]
        self._steps = 0
        self._scale, self._turned = 1.0, 1.0 + 0.0j
        if errors.scale > 0.0 or errors.mounting_error_deg > 0.0:
            longer, left = noise.choice((-1.0, 1.0), size=2)
            self._scale += float(longer) * errors.scale
            self._turned = rotation(float(left) * math.radians(errors.mounting_error_deg))

    def measure(self, plant: Moving, others: Iterable[tuple[complex, float]]) -> bool:
        """Measure the beams of one step, and of those that were missed; return whether a turn is complete.

        `others` are other robots' bodies: centre, radius [m; world].
        """
        scanner, mount = self._scanner, self._mount
        axis = mount.heading * self._turned * rotation(self._angle_min)
        true = plant.cast(mount.at, axis, scanner.beams, scanner.range_max)
        if true is None:
            at, heading = plant.position + plant.heading * mount.at, plant.heading * axis
            true = raycast.cast(at, heading, (*others, *self._posts), self._walls, scanner.beams)
        before, self._steps = self._steps, self.rate.ticks + self.rate.missed
        for step in range(max(before, self._steps - self._sectors), self._steps):
            sector = self._sector(step % self._sectors)
            self._true[sector] = true[sector]
        return self._steps // self._sectors > before // self._sectors

    def scan(self, stamp: float) -> LaserScan:
        """Return the scan of the newest complete turn, with this stamp [s]."""
        scanner, turn_time = self._scanner, self._turn_time
        normal, uniform = self._noise.normal(size=scanner.beams), self._noise.random(scanner.beams)
        return LaserScan(
            stamp,
            angle_min=self._angle_min,
            angle_increment=math.tau / scanner.beams,
            range_min=scanner.range_min,
            range_max=scanner.range_max,
            ranges=raycast.measured(self._true, scanner, normal.tolist(), uniform.tolist(), self._scale),
            time_increment=0.0 if self._model is None else turn_time / scanner.beams,
            scan_time=turn_time,
        )

    def _sector(self, step: int) -> slice:
        """The beams of one step of a turn."""
        backwards = self._model is not None and self._model.newest_first
        place = self._sectors - 1 - step if backwards else step
        first, end = (number * self._scanner.beams // self._sectors for number in (place, place + 1))
        return slice(first, end)


class Localiser:
    """The localiser of one robot: poses in the map as AMCL publishes them, rare, uneven, late and noisy."""

    def __init__(self, noise: np.random.Generator) -> None:
        self._noise = noise
        self._last: tuple[complex, complex] | None = None
        self._waiting: list[tuple[float, MapPose]] = []  # when each is due [s], oldest first

    def poses(self, stamp: float, position: complex, heading: complex) -> list[MapPose]:
        """Return what it publishes at `stamp` [s], when the robot is at `position` [m], `heading` (unit)."""
        if self._last is None or self._moved(position, heading):
            self._last = position, heading
            x, y, turn = self._noise.normal(size=3)
            measured = MapPose(
                stamp,
                position + POSE_DEVIATION * complex(x, y),
                heading * rotation(HEADING_DEVIATION * float(turn)),
                POSE_DEVIATION,
                HEADING_DEVIATION,
            )
            self._waiting.append((stamp + SCAN_TO_POSE_TIME, measured))
        due = [pose for when, pose in self._waiting if when <= stamp]
        self._waiting = self._waiting[len(due) :]
        return due

    def _moved(self, position: complex, heading: complex) -> bool:
        at, facing = self._last or (position, heading)
        turned = abs(float(angle_between(facing, heading)))
        return abs(position - at) >= UPDATE_DISTANCE or turned >= UPDATE_ANGLE


class _Robot:
    """A plant with its clock, its rates and its sensors."""

    def __init__(self, mission: Mission, name: str, plant: Moving, seed: int, phase: float) -> None:
        spec = mission.robots[name]
        self.name = name
        self.plant = plant
        self.odometry_frame = "map" if spec.odometry_frame == "world" else "odom"
        self.watched = spec.localisation == "external"
        """Whether an external camera measures its position."""
        self.localiser: Localiser | None = None
        if spec.odometry_frame == "map":
            self.localiser = Localiser(np.random.default_rng([seed, mission.names.index(name), 2]))
        self.rate = Rate(spec.rate, phase)
        self.ranging: Ranging | None = None
        if spec.scanner != "none":
            seen = np.random.default_rng([seed, mission.names.index(name), 1])
            self.ranging = Ranging(mission, name, seen, phase)
        self.sees = spec.measurable if spec.measurement == "local" else ()
        self._radius, self._seen = spec.radius, spec.seen
        self._stamped = spec.cmd_vel == "twist_stamped"
        self._offset = spec.control_point_offset
        self._repeated: dict[tuple[str, str], object] = {}  # what stuck sensors measured last, and of what
        self._late: list[tuple[float, Outgoing]] = []  # reports of late sensors, and when they are due

    @property
    def rates(self) -> tuple[Rate, ...]:
        """Rates of all its messages."""
        return (self.rate, self.ranging.rate) if self.ranging else (self.rate,)

    @property
    def disc(self) -> tuple[complex, float]:
        """What scanners see of it: centre and radius [m; world frame]."""
        return self.plant.position + self.plant.heading * self._seen.at, self._seen.radius or self._radius

    @property
    def control_point(self) -> complex:
        """True control point [m; world frame]."""
        return control_point(self.plant.position, self.plant.heading, self._offset)

    def read(self, payload: bytes) -> Command:
        """The command in `payload`, of the one type that this robot takes. Raises BadMessage."""
        twist = decode(TwistStamped, payload) if self._stamped else decode(Twist, payload)
        return Command(twist.speed, twist.turn_rate)

    def measured(self, sensor: str, of: str, true: Measurement) -> Measurement:
        """Return what `sensor` shows of a robot instead of `true`: that, or the same again if it is stuck."""
        key = sensor, of
        if sensor not in self.plant.disturbed.stuck:
            self._repeated.pop(key, None)
            return true
        return cast("Measurement", self._repeated.setdefault(key, true))

    def reported(self, reports: list[Outgoing], time: float, late: float) -> list[Outgoing]:
        """Return the reports that arrive at `time` [s, monotonic], after adding new `reports`.

        These arrive `late` [s] later, also after the sensors are prompt again.
        """
        self._late += [(time + late, one) for one in reports]
        arrived = [one for due, one in self._late if due <= time]
        self._late = [(due, one) for due, one in self._late if due > time]
        return arrived

    def go_to(self, time: float) -> None:
        """Simulate the plant until `time` [s, monotonic]."""
        self.plant.go_to(time)


def _check(mission: Mission, names: Sequence[str]) -> None:
    """Raise ValueError unless these robots can be simulated together."""
    for name in names:
        if name not in mission.followers:
            followers = ", ".join(mission.followers)
            raise ValueError(f"robot {name!r}: must be a follower of {mission.name}: {followers}")
    for name in names:
        spec = mission.robots[name]
        unseen = [other for other in spec.measurable if other not in (*names, mission.leader)]
        if spec.measurement == "local" and unseen:
            raise ValueError(
                f"robot {name!r} measures {unseen[0]!r} with a sensor: a simulated sensor sees the leader and"
                f" robots of its own process, which hosts {', '.join(names)}"
            )


def host(world: World, process: Runtime) -> Pauses:
    """Declare, wait for a monitor if requested, then simulate until told to stop.

    The loop sleeps until the next odometry is due or a command arrives, so a command takes effect at once.
    """
    robots = process.robot
    for topic, key in world.publications:
        robots.advertise(topic, key)
    for key in world.subscriptions:
        topic = address(key).topic
        if topic.side == "robot":
            robots.subscribe(topic, key)
        else:
            process.bus.subscribe(key)

    def send(outbox: Iterable[Outgoing]) -> None:
        for out in outbox:
            robots.publish(out.key, out.payload)

    process.ready(*(GROUND_TRUTH.key(name) for name in world.robots))
    yield from process.loop(world, send)
    for key, count in world.dropped.items():
        _log.warning("%d messages on %s were no commands, and were not obeyed", count, key)
