"""Where simulated robots are: the stage, which tells the monitor the truth. In the field there is none."""

from __future__ import annotations

from collections.abc import Sequence

from formation.mission import Mission
from formation.transport import wiring


def usual(mission: Mission) -> dict[str, str]:
    """Where `formation robot` puts simulated robots of this machine, by robot.

    A robot whose endpoint the mission names is taken for a real one: its ROS 2 router is there.
    """
    ends = wiring.endpoints(mission).robots
    return {name: end for name, end in ends.items() if not mission.robots[name].robot_endpoint}


def given(mission: Mission, texts: Sequence[str]) -> dict[str, str]:
    """Endpoints by robot, from flags: ``ENDPOINT`` is where all robots are, ``robot2,robot3=ENDPOINT`` some.

    Raises ValueError for a robot that is no follower of the mission.
    """
    ends: dict[str, str] = {}
    for text in texts:
        names, equals, end = text.partition("=")
        if not equals or "/" in names:  # an endpoint may have an equals sign of its own
            names, end = ",".join(mission.followers), text
        for name in names.split(","):
            if name not in mission.followers:
                legal = ", ".join(mission.followers)
                raise ValueError(f"--stage {text!r}: {name!r} must be a follower of {mission.name}: {legal}")
            ends[name] = end
    return ends
