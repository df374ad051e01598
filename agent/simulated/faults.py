"""Faults of a simulated robot's sensors and wheels, so that a fleet can rehearse them.

frozen    odometry and camera continue to report the place where the fault began, with new stamps
tremble   the same, plus or minus `size` [m] (standard deviation per axis)
stutter   as frozen, and reported in bursts of `size` [s], with gaps as long between
stale     odometry and external pose arrive `size` [s] late, with their true stamps
restamped the same, but stamped when they are published, so that their stamps look fresh
backlog   they arrive later and later, by `size` every second [s/s]
speeds    odometry reports `size` times its true speeds; 0 is a robot that seems to stand
blocked   the wheels do not turn, or spin without moving the robot (which a camera sees)
carried   the robot is moved at `size` [m/s] along the world's x axis

relative_frozen  the sensor of neighbours repeats its displacements, with new stamps
scan_frozen      the range scanner repeats one scan, with new stamps
relative_late    displacements of neighbours arrive `size` [s] late, with their true stamps
scan_late        range scans arrive `size` [s] late, with their true stamps
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from formation.agent.simulated.plant import Disturbed, Moving, Plant
from formation.control.unicycle import Command
from formation.mission.model import Mission
from formation.mission.robot import RobotSpec


class Size(NamedTuple):
    """What the SIZE of a kind of fault may be, in its unit."""

    usual: float
    """Where none is given."""
    lowest: float
    highest: float
    unit: str = ""
    """Without one it is a share."""

    def illegal(self, size: float) -> str | None:
        """Return why `size` is none of these, in words; None if it is one."""
        if self.lowest <= size <= self.highest:
            return None
        unit = f" {self.unit}" if self.unit else ""
        return f"SIZE must be from {self.lowest:g} to {self.highest:g}{unit}"


DELAYS = 0.0, 60.0, "s"
"""Least and greatest delay that can be simulated."""
SIZES: Mapping[str, Size | None] = {
    "frozen": None,
    "tremble": Size(1e-3, 0.0, 1.0, "m"),
    "stutter": Size(0.35, 0.01, 60.0, "s"),
    "stale": Size(1.0, *DELAYS),
    "restamped": Size(1.0, *DELAYS),
    "backlog": Size(1.0, 0.0, 10.0, "s/s"),
    "speeds": Size(0.0, -10.0, 10.0),
    "blocked": None,
    "carried": Size(0.2, -10.0, 10.0, "m/s"),
    "relative_frozen": None,
    "scan_frozen": None,
    "relative_late": Size(1.0, *DELAYS),
    "scan_late": Size(1.0, *DELAYS),
}
"""Kinds of faults, and what their sizes may be; None for one without a size."""
STANDS = frozenset(("frozen", "tremble", "stutter"))
STUCK: Mapping[str, str] = {"relative_frozen": "relative", "scan_frozen": "scan"}
"""Sensors of a robot's surroundings that a fault of this kind makes repeat what they measured."""
LATE: Mapping[str, str] = {"relative_late": "relative", "scan_late": "scan"}
"""Sensors of a robot's surroundings that a fault of this kind delays."""
_TEXT = re.compile(
    r"(?P<robot>[\w-]+):(?P<kind>[a-z_]+)(=(?P<size>[^@]+))?@(?P<since>[.\d]+)(\+(?P<lasts>[.\d]+))?"
)
FORM = "ROBOT:KIND[=SIZE]@START[+SECONDS]"


class Fault(NamedTuple):
    """One fault of one robot."""

    robot: str
    kind: str
    size: float
    since: float
    """After the simulation began [s]."""
    lasts: float = math.inf
    """[s]"""


def parse(
    text: str, mission: Mission, sizes: Mapping[str, Size | None] = SIZES, *, form: str = FORM
) -> Fault:
    """Parse a fault of a robot of `mission` in the format `form`; `sizes` as `SIZES`.

    Raises ValueError, which names the legal values. The caller checks whether there is such a robot.
    """
    found = _TEXT.fullmatch(text)
    if found is None:
        raise ValueError(f"{text!r}: must be {form}, such as robot2:frozen@20+10; numbers without units")
    kind = found["kind"]
    if kind not in sizes:
        raise ValueError(f"{text!r}: {kind}: must be one of {', '.join(sizes)}")
    legal_size = sizes[kind]
    if legal_size is None and found["size"] is not None:
        raise ValueError(f"{text!r}: {kind} takes no SIZE")
    try:
        size = float(found["size"] or (legal_size.usual if legal_size else 0.0))
        since, lasts = float(found["since"]), float(found["lasts"] or "inf")
    except ValueError:
        raise ValueError(f"{text!r}: SIZE, START and SECONDS must be numbers without units") from None
    if legal_size is not None and (wrong := legal_size.illegal(size)):
        raise ValueError(f"{text!r}: {wrong}")
    robot = found["robot"]
    if robot in mission.followers and not concerns(kind, mission.robots[robot]):
        legal = legal_robots(mission, lambda spec: concerns(kind, spec))
        raise ValueError(f"{text!r}: {robot} has no sensor for {kind}; {legal}")
    return Fault(robot, kind, size, since, lasts)


def legal_robots(mission: Mission, able: Callable[[RobotSpec], bool]) -> str:
    """Name the followers of `mission` that are `able` to have a fault, in words."""
    names = [name for name in mission.followers if able(mission.robots[name])]
    return f"must be {' or '.join(names)}" if names else "no robot of the mission has one"


def concerns(kind: str, spec: RobotSpec) -> bool:
    """Whether a robot has the sensor that a fault of this kind is of."""
    sensor = {**STUCK, **LATE}.get(kind)
    if sensor == "relative":
        return spec.measurement == "local"
    return sensor != "scan" or spec.scanner != "none"


class Faulty:
    """A plant with faults, used instead of the plant."""

    def __init__(self, plant: Plant, faults: Iterable[Fault], seed: int) -> None:
        self.plant = plant
        """The true robot."""
        self._faults, self._noise = tuple(faults), np.random.default_rng(seed)
        self._began: float | None = None
        self._time = 0.0  # since then [s]
        self._command = plant.command
        self._places: dict[str, tuple[complex, complex]] = {}  # that sensors continue to report

    @property
    def position(self) -> complex:
        """True centre [m; world frame]."""
        return self.plant.position

    @property
    def heading(self) -> complex:
        """True heading, unit complex [world frame]."""
        return self.plant.heading

    @property
    def command(self) -> Command:
        """Its present command."""
        return self.plant.command

    @property
    def moving(self) -> Command:
        """Forward speed and turn rate as odometry reports them."""
        speed, turn_rate = self.plant.moving
        for fault in self._active():
            share = 0.0 if fault.kind in STANDS else fault.size if fault.kind == "speeds" else 1.0
            speed, turn_rate = share * speed, share * turn_rate
        return Command(speed, turn_rate)

    @property
    def disturbed(self) -> Disturbed:
        """How its sensors are disturbed now."""
        active = self._active()
        restamped = [one.size for one in active if one.kind == "restamped"]
        constant = [one.size for one in active if one.kind == "stale"]
        growing = [one.size * (self._time - one.since) for one in active if one.kind == "backlog"]
        bursts = [one for one in active if one.kind == "stutter" and one.size > 0.0]
        return Disturbed(
            late=max([0.0, *constant, *growing, *restamped]),
            restamped=max([0.0, *restamped]),
            pauses=any((self._time - one.since) % (2.0 * one.size) >= one.size for one in bursts),
            stuck=frozenset(STUCK[kind] for kind in self._kinds() & STUCK.keys()),
            surroundings_late={LATE[one.kind]: one.size for one in active if one.kind in LATE},
        )

    def obey(self, command: Command) -> None:
        """Follow `command`, unless the wheels are blocked."""
        self._command = command
        self.plant.obey(Command(0.0, 0.0) if "blocked" in self._kinds() else command)

    def go_to(self, time: float) -> None:
        """Simulate the plant until `time` [s, any clock]."""
        self._began = time if self._began is None else self._began
        over, self._time = time - self._began - self._time, max(self._time, time - self._began)
        self.obey(self._command)
        self.plant.go_to(time)
        for fault in self._active():
            if fault.kind == "carried":
                self.plant.position += fault.size * max(over, 0.0)
        if not STANDS.intersection(self._kinds()):
            self._places.clear()

    def odometry(self) -> tuple[complex, complex]:
        """Centre [m] and heading as this robot measures them [its own frame]."""
        return self._sensed("odometry", self.plant.odometry())

    def seen(self) -> tuple[complex, complex]:
        """Centre [m] and heading as a camera above sees them [world frame]."""
        return self._sensed("camera", self.plant.seen())

    def cast(self, at: complex, heading: complex, beams: int, farthest: float) -> None:
        """Return None: the plant does not know its surroundings."""

    def _sensed(self, sensor: str, true: tuple[complex, complex]) -> tuple[complex, complex]:
        for fault in self._active():
            if fault.kind in STANDS:
                position, heading = self._places.setdefault(sensor, true)
                x, y = self._noise.normal(size=2)
                noise = fault.size if fault.kind == "tremble" else 0.0
                return position + noise * complex(x, y), heading
        return true

    def _active(self) -> list[Fault]:
        return [one for one in self._faults if one.since <= self._time < one.since + one.lasts]

    def _kinds(self) -> set[str]:
        return {one.kind for one in self._active()}


def with_faults(
    plants: Callable[[Mission, Sequence[str], int], Mapping[str, Plant]], faults: Sequence[Fault]
) -> Callable[[Mission, Sequence[str], int], Mapping[str, Moving]]:
    """Return `plants` with faults, for a simulated world. Raises ValueError for one of an unknown robot."""

    def made(mission: Mission, robots: Sequence[str], seed: int) -> Mapping[str, Moving]:
        for fault in faults:
            if fault.robot not in robots:
                raise ValueError(f"--fault {fault.robot}: must be one of {', '.join(robots)}")
        of = {name: [one for one in faults if one.robot == name] for name in robots}
        return {
            name: Faulty(plant, of[name], seed + number) if of[name] else plant
            for number, (name, plant) in enumerate(plants(mission, robots, seed).items())
        }

    return made
