"""The stage: endpoints of simulated robots, for ground truth. In the field there is none."""

from __future__ import annotations

from collections.abc import Sequence

from formation.mission.model import Mission
from formation.transport import wiring


def usual(mission: Mission) -> dict[str, str]:
    """Return the endpoints at which `formation robot` simulates robots on this machine, by robot.

    A robot with an endpoint in the mission is taken for a real one: its ROS 2 router is there.
    """
    ends = wiring.endpoints(mission).robots
    return {name: end for name, end in ends.items() if not mission.robots[name].robot_endpoint}


def given(mission: Mission, texts: Sequence[str]) -> dict[str, str]:
    """Return endpoints by robot from flags: ``ENDPOINT`` for all, ``robot2,robot3=ENDPOINT`` for some.

    Raises ValueError for a robot that is no follower of the mission.
    """
    ends: dict[str, str] = {}
    for text in texts:
        names, equals, end = text.partition("=")
        if not equals or "/" in names:  # an endpoint may contain an equals sign
            names, end = ",".join(mission.followers), text
        for name in names.split(","):
            if name not in mission.followers:
                legal = ", ".join(mission.followers)
                raise ValueError(f"--stage {text!r}: {name!r} must be a follower of {mission.name}: {legal}")
            ends[name] = end
    return ends
