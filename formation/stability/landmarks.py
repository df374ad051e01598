"""Can robots see each other with their scanners? Warnings before any robot moves."""

from __future__ import annotations

from collections.abc import Iterator

from formation.mission.model import Mission

BURGER_SEEN = "seen = { radius = 0.035, x = -0.032 }"
"""What scanners see of a TurtleBot3 Burger, as a mission states it: its own scanner."""


def unstated(mission: Mission) -> Iterator[str]:
    """TurtleBot3 Burgers of which a mission says that scanners see their bodies, which are lower."""
    if mission.simulated_robot.profile != "turtlebot3_burger":
        return
    if all(mission.robots[name].scanner == "none" for name in mission.followers):
        return
    names = [name for name in mission.followers if mission.robots[name].seen.radius is None]
    if names:
        yield (
            f"{', '.join(names)}: other scanners see a TurtleBot3 Burger's scanner, not its body, so robots"
            f" may touch or not find each other; say {BURGER_SEEN} under [robot]"
        )


def warnings(mission: Mission) -> Iterator[str]:
    """Robots that drift apart, or are out of sight of each other."""
    yield from unstated(mission)
    seeing = [name for name in mission.followers if mission.robots[name].measurement == "scan"]
    alone = [name for name in seeing if not mission.landmarks_of(name)]
    if len(alone) > 1:
        yield (
            f"{', '.join(alone)}: have no neighbour that is nearer to the leader and has a body, so each goes"
            " by its own odometry and they drift apart; give all but one of them such a neighbour"
        )
    for name in seeing:
        landmarks = mission.landmarks_of(name)
        furthest = mission.simulated_scanner.scanner(mission.robots[name].scan).range_max
        for shape in mission.shapes:
            near = min(
                (abs(mission.slot(one, shape) - mission.slot(name, shape)) for one in landmarks), default=0.0
            )
            if near > furthest:
                yield (
                    f"{name}: in shape {shape} its nearest neighbour to be seen is {near:.2f} m away; the"
                    f" simulated scanner measures {furthest:g} m"
                )
