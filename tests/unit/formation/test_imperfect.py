"""The collision filter with noise and delay: robots come to their slots, and bodies do not touch."""

from __future__ import annotations

import numpy as np
import pytest

from formation.control.arrays import FloatArray
from formation.control.laws import LAWS
from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.body import Body
from formation.simulation.ensemble import Ensemble, Options, Starts, random_starts
from formation.stability.analysis import analyse
from tests.unit.formation import scenarios

HORIZON = 60.0
"""[s]"""
LATE, SHAKEN = (9, 83, 206, 298, 349, 383), (9, 37, 74, 83, 98, 157)
"""Of 400 starts those in which a robot was left behind with 100 ms of delay, and with 2 mm of noise, too."""


@pytest.mark.parametrize(("noise", "delay", "chosen"), [(0.0, 0.1, LATE), (0.002, 0.1, SHAKEN)])
def test_no_robot_is_left_behind(noise: float, delay: float, chosen: tuple[int, ...]) -> None:
    mission = load("six_robots")
    starts = random_starts(mission, 400, mission.simulation.spread, _draw(0))
    some = Starts(starts.position[list(chosen)], starts.heading[list(chosen)])
    error, nearest = driven(mission, some, noise, delay)
    assert error.max() < 1.0
    assert nearest.min() > 0.0


def test_two_robots_that_start_close_by_find_their_slots() -> None:
    """By the collision filter alone: with the ramp these starts can keep the robots from leaving."""
    mission = scenarios.ramped(close_by(0.004), 0.0)
    places = [mission.robots[name].start for name in mission.followers]
    starts = Starts(np.array([[one.position for one in places]]), np.array([[one.heading for one in places]]))
    error, nearest = driven(mission, starts, 1e-4, 0.05)
    assert error.max() < 1.0
    assert nearest.min() > 0.0


@pytest.mark.parametrize(("gap", "warned"), [(0.004, True), (0.2, False)])
def test_check_warns_of_starts_too_close(gap: float, warned: bool) -> None:
    result = [one for one in analyse(close_by(gap)).warnings if "between their bodies" in one]
    assert len(result) == warned


def close_by(gap: float) -> Mission:
    """The pair of TurtleBots, side by side with so much between their bodies [m]."""
    result = load("turtlebot3_pair").model_dump()
    for name, side in (("robot1", 1.0), ("robot2", -1.0)):
        result["robots"][name]["start"] = {"x": -0.8, "y": side * (0.105 + 0.5 * gap), "heading_deg": 0.0}
    return Mission.model_validate(result)


def driven(mission: Mission, starts: Starts, noise: float, delay: float) -> tuple[FloatArray, FloatArray]:
    """Error at the end [m] and least distance between two bodies [m] of every run."""
    step = mission.simulation.step
    steps = round(HORIZON / step)
    body = Body.of(mission.simulated_robot)._replace(position_noise=noise)
    runs = Ensemble(
        mission, LAWS["field"], Options(delay=delay, body=body), starts, step, _draw(1), steps, steps
    )
    runs.run_on(steps)
    return runs.error, runs.nearest


def _draw(child: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(0).spawn(2)[child])
