"""Can robots that correct their poses by their scanners see each other? Warnings before any robot moves."""

from __future__ import annotations

from collections.abc import Iterator

from formation.mission.model import Mission


def warnings(mission: Mission) -> Iterator[str]:
    """Robots that drift apart, or are out of sight of each other."""
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
