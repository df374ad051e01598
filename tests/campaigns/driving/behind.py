"""`python -m tests.campaigns.driving.behind`: five robots behind one that is driven, and a line of followers.

Both in MuJoCo, from the same displaced starts, with the same ten drives. Ours: the mission `convoy` with six
robots in a shape that does not turn, which see each other by their scanners. The line: robots that follow the
one before them by odometry (`line_follower`). Errors are true ones, from 20 s on, root mean square over all
pairs of a robot and one that it measures: of the *place*, in the shape turned as fits best, and of the
*distance*, from what is wanted; for the line, which wants none, from the median of each pair.
"""

from __future__ import annotations

import argparse
import os
from itertools import pairwise
from statistics import median

from formation.control.unicycle import Command
from formation.deploy.driving.remote import PERIOD_SECONDS
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.operator import Operator
from formation.leader.driving import ramped
from formation.mission.file import loads, read
from formation.mission.model import Mission
from formation.stability.driving import STANDS, Velocity, first_limits, followable
from tests.campaigns.driving.gamepad_drives import drive
from tests.campaigns.driving.line_follower import PLAN_SECONDS, STEP_SECONDS, Follower, Pose
from tests.campaigns.perception.drift import Displaced
from tests.support.seeing import Errors, displaced, edges, misfit, rms

SETTLING_SECONDS = 20.0
PLACES = {
    "robot1": ((0.0, 0.0), ["leader"]),
    "robot2": ((-0.5, 0.5), ["robot1"]),
    "robot3": ((-0.5, -0.5), ["robot1"]),
    "robot4": ((-1.0, 0.0), ["robot2", "robot3"]),
    "robot5": ((-1.0, 1.0), ["robot2", "robot4"]),
    "robot6": ((-1.0, -1.0), ["robot3", "robot4"]),
}
"""Slot relative to the leader [m], and neighbours."""
GAPS = (0.2, 0.4)
"""Distances that robots of a line keep [m]: as shipped, and with more room."""


def mission(errors: Errors) -> Mission:
    """Return `convoy` with six robots."""
    data = loads(read("convoy")[0])
    del data["shapes"]["column"]
    data["turning"] = False
    data["shapes"]["diamond"] = {name: list(slot) for name, (slot, _) in PLACES.items()}
    for name, ((x, y), neighbours) in PLACES.items():
        data["robots"][name] = {"neighbours": neighbours, "start": {"x": x - 0.05, "y": y, "heading_deg": 0}}
    scanner = {"lost": errors.lost, "scale": errors.scale, "mounting_error_deg": errors.mounting_deg}
    data["simulated_scanner"] = scanner
    return Mission.model_validate(data)


def ours(errors: Errors, seed: int, seconds: float) -> tuple[float, float, float]:
    """Errors of place and distance, and of the places that robots measure, of one drive [m]."""
    of = mission(errors)
    fleet = Displaced(of, errors, seed, Weather(), "mujoco")
    within, stick = first_limits(of), drive(seed, seconds)

    def velocity(time: float) -> tuple[float, float]:
        share = stick(time)
        return share.forward * within.speed, share.turn * within.turn_rate

    places, distances, measured = [], [], []
    fleet.engine.run(SETTLING_SECONDS)
    Operator(fleet).drive_by(velocity, seconds)
    for second in range(int(seconds)):
        fleet.engine.run(SETTLING_SECONDS + second + 1.0)
        at = dict(zip(of.names, fleet._points(), strict=True))
        believed = {name: agent.here.point for name, (agent, _) in fleet.agents.items()}
        slots = dict(zip(of.names, fleet.leading.wanted.slots(of), strict=True))
        pairs = edges(of)
        wanted = [slots[j] - slots[i] for i, j in pairs]
        true = [at[j] - at[i] for i, j in pairs]
        places.append(complex(misfit(true, wanted)))
        measured.append(complex(misfit([believed[j] - believed[i] for i, j in pairs], wanted)))
        distances += [complex(abs(one) - abs(want)) for one, want in zip(true, wanted, strict=True)]
    return rms(places), rms(distances), rms(measured)


class Line:
    """A leader that is driven directly, and followers one behind another, in one world."""

    def __init__(self, errors: Errors, seed: int, gap: float) -> None:
        os.environ.setdefault("MUJOCO_GL", "disable")
        from formation.agent.simulated.physics.world import World

        of = mission(errors)
        robots = dict(of.robots)
        for number, name in enumerate(of.followers):
            start = robots[name].start.model_copy(update={"x": -(gap + 0.1) * number, "y": 0.0})
            robots[name] = robots[name].model_copy(update={"start": start})
        of = of.changed(robots=robots)
        real = displaced(of, errors, seed)
        self.names = of.followers
        self.world = World(real, seed)
        self._starts = {name: (of.robots[name].start, real.robots[name].start) for name in self.names}
        self.followers = {name: Follower(of.robots[name].max_speed, gap) for name in self.names[1:]}

    def believed(self, name: str) -> Pose:
        """Where a robot is by its odometry, from the start that it was told."""
        state, (told, real) = self.world.states[name], self._starts[name]
        turn = told.heading * real.heading.conjugate()
        moved = state.counted_position - real.position
        return Pose(told.position + moved * turn, state.counted_heading * turn)

    def step(self, velocity: Velocity, *, plans: bool) -> None:
        """Drive all for STEP_SECONDS."""
        poses = {name: self.believed(name) for name in self.names}
        commands = {self.names[0]: Command(*velocity)}
        for before, name in pairwise(self.names):
            if plans:
                self.followers[name].plan(poses[before])
            commands[name] = self.followers[name].step(poses[name])
        self.world.step(commands, STEP_SECONDS)

    def distances(self) -> list[float]:
        """True distance of each robot from the one before [m]."""
        at = [self.world.states[name].position for name in self.names]
        return [abs(one - other) for one, other in pairwise(at)]


def line(errors: Errors, seed: int, seconds: float, gap: float) -> tuple[float, float]:
    """Error of the distances [m], and the greatest distance of a robot from the one before [m]."""
    within, stick = first_limits(mission(errors)), drive(seed, seconds)
    one, velocity, found = Line(errors, seed, gap), STANDS, []
    for number in range(round((SETTLING_SECONDS + seconds) / STEP_SECONDS)):
        time = number * STEP_SECONDS - SETTLING_SECONDS
        share = stick(time)
        wanted = followable(Velocity(share.forward * within.speed, share.turn * within.turn_rate), within)
        velocity = ramped(velocity, wanted, within, PERIOD_SECONDS) if wanted != STANDS else STANDS
        one.step(velocity, plans=number % round(PLAN_SECONDS / STEP_SECONDS) == 0)
        if time >= 0.0 and number % 20 == 0:
            found.append(one.distances())
    middles = [median(column) for column in zip(*found, strict=True)]
    off = [complex(each - middle) for row in found for each, middle in zip(row, middles, strict=True)]
    return rms(off), max(map(max, found))


def main() -> None:
    """Print a row for each drive."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaigns.driving.behind", description=__doc__)
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--scale", type=float, default=0.0, help="error of distances, as a share")
    parser.add_argument("--mounting", type=float, default=0.0, help="error of directions [°]")
    flags = parser.parse_args()
    errors = Errors(scale=flags.scale, mounting_deg=flags.mounting)
    ratios: dict[float, list[float]] = {gap: [] for gap in GAPS}
    for seed in range(flags.drives):
        place, distance, measured = ours(errors, seed, flags.seconds)
        known = f"{100 * place:.2f} cm ({100 * measured:.2f} as the robots know them)"
        parts = [f"drive {seed}: places {known}, distances {100 * distance:.2f} cm"]
        for gap, found in ratios.items():
            off, farthest = line(errors, seed, flags.seconds, gap)
            found.append(off / place)
            parts.append(
                f"line at {gap} m: {100 * off:.1f} cm, {farthest:.2f} m at most, {found[-1]:.1f} times"
            )
        print("; ".join(parts), flush=True)
    for gap, found in ratios.items():
        print(f"line at {gap} m: median {median(found):.1f} times, least {min(found):.1f}")


if __name__ == "__main__":
    main()
