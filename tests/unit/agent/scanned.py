"""A simulated robot with a range scanner among posts and walls; its agent's scanner limits its commands."""

from __future__ import annotations

import math
import random
from collections.abc import Collection, Sequence

from formation.agent.safety.scanner import Scanner
from formation.control.pipeline import protected
from formation.control.unicycle import AT_REST, Command, advance, driven
from formation.mission.file import parse, read
from formation.mission.model import Mission
from formation.ros2.messages import LaserScan, decode, encode
from formation.sensing.raycast import Scanner as Device
from formation.sensing.raycast import cast, measured
from tests.support.fleet import EPOCH, at

STEP = 0.01
LAG, RADIUS, MARGIN = 0.1, 0.1, 0.05
Wall = tuple[complex, complex]
Disc = tuple[complex, float]


def mission(scanner: str = "required", scan: str = "", lag: float = LAG) -> Mission:
    text, name = read("six_robots")
    robot = f'[robot]\nscanner = "{scanner}"\nscan = {{ margin = {MARGIN}, lag = {lag}{scan} }}'
    return parse(text.replace("[robot]", robot), name)


def scan(
    stamp: float, ranges: Sequence[float], time_increment: float = 0.0, device: Device | None = None
) -> LaserScan:
    step, sees = math.tau / len(ranges), device or Device()
    return LaserScan(EPOCH + stamp, 0.0, step, sees.range_min, sees.range_max, tuple(ranges), time_increment)


def post(distance: float) -> list[float]:
    """Ranges of a scan with one object straight ahead."""
    return [distance, *[math.inf] * 359]


def distance_to_wall(here: complex, begin: complex, end: complex) -> float:
    """Distance from a wall [m]."""
    along = ((here - begin) / (end - begin)).real
    return abs(here - begin - min(max(along, 0.0), 1.0) * (end - begin))


def scanner_after(ranges: Sequence[float], stamp: float = 0.0, scanning: str = "") -> Scanner:
    """A scanner at rest after one scan; `scanning` are more keys of `scan` in the mission."""
    scanner = Scanner(mission(scan=scanning), "robot2")
    scanner.process_scan(scan(stamp, ranges), stamp, at(stamp))
    return scanner


class Robot:
    """A round robot with a scanner, and its agent's scanner, among posts and walls.

    It executes commands while the scan is fresh, doubted or not, like a robot with an optional scanner.
    """

    def __init__(
        self,
        discs: Sequence[Disc] = (),
        walls: Sequence[Wall] = (),
        delay: float = 0.0,
        rate: float = 5.0,
        missing: Collection[int] = (),
        too_near: float = 0.0,
        behind: float = 0.0,
        odometry: bool = True,
        lag: float = LAG,
        **device: float,
    ) -> None:
        """Scans come at `rate` [Hz], `delay` [s] late, except the scans with numbers in `missing`.

        Ranges below the scanner's minimum are `too_near`. The scanner is mounted `behind` the centre [m].
        Without `odometry` its agent knows only the commands. The wheels have a `lag`, as in the mission.
        """
        self.scanner = Scanner(mission(scan=f", rate = {rate}, x = {-behind}", lag=lag), "robot2")
        self.position, self.heading, self.moving, self.time = 0j, 1.0 + 0j, AT_REST, 0.0
        self.discs, self.walls, self.delay, self.nearest = discs, walls, delay, math.inf
        self.device, self.rng = Device(**device), random.Random(3)  # type: ignore[arg-type]
        self._every, self._missing, self._too_near = round(1.0 / rate / STEP), missing, too_near
        self._behind, self._odometry, self._lag = behind, odometry, lag
        self._underway: list[LaserScan] = []

    def drive(self, wanted: Command, seconds: float) -> None:
        """Drive as wanted, as far as the scans allow."""
        command = AT_REST
        for _ in range(round(seconds / STEP)):
            tick = round(self.time / STEP)
            if tick % self._every == 0 and tick // self._every not in self._missing:
                self._underway.append(self.look())
            while self._underway and self.time >= self._underway[0].stamp - EPOCH + self.delay - 1e-9:
                self.scanner.process_scan(self._underway.pop(0), self.time, at(self.time))
            if tick % 5 == 0:
                if self._odometry:
                    self.scanner.moved(self.time, self.moving)
                now = at(self.time)
                sight = self.scanner.sight(self.scanner.strangers(now, []), now)
                command = protected(wanted, sight)[0] if self.scanner.fresh(now) else command
                if not self._odometry:
                    self.scanner.commanded(self.time, command)
            mean, self.moving = driven(self.moving, command, self._lag, STEP)
            self.position, self.heading = advance(self.position, self.heading, *mean, STEP)
            self.time += STEP
            self.nearest = min(self.nearest, *self.gaps())

    def gaps(self) -> list[float]:
        """Distances from the robot's body to all objects [m]."""
        gaps = [abs(centre - self.position) - radius - RADIUS for centre, radius in self.discs]
        return gaps + [distance_to_wall(self.position, *wall) - RADIUS for wall in self.walls]

    def look(self) -> LaserScan:
        sits = self.position - self._behind * self.heading
        true = cast(sits, self.heading, self.discs, self.walls, 360)
        normal, uniform = [self.rng.gauss(0.0, 1.0) for _ in true], [self.rng.random() for _ in true]
        says = [
            self._too_near if there < self.device.range_min else result
            for there, result in zip(true, measured(true, self.device, normal, uniform), strict=True)
        ]
        return decode(LaserScan, encode(scan(self.time, says, device=self.device)))
