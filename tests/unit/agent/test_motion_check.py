"""Commands beside what odometry shows, without an agent."""

from __future__ import annotations

from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.pose.motion_check import MotionCheck
from formation.control.observer import Travel
from formation.control.unicycle import Command
from formation.mission.file import load
from formation.protocol.status import MotionFault

PERIOD = 0.05
"""Of commands and of odometry [s]."""
SPEED = 0.2
"""[m/s]"""


class Straight:
    """A robot that drives forward and back on a line as it is commanded, and its motion check."""

    def __init__(self, delay: float) -> None:
        """Positions are `delay` [s] old, to a period."""
        self.check = MotionCheck(load("turtlebot3_pair"), "robot2")
        self._places = [0.0] * (1 + round(delay / PERIOD))
        self._seen, self._moment = 0.0, 10.0

    def drive(
        self,
        speed: float,
        seconds: float,
        *,
        frozen: bool = False,
        scale: float = 1.0,
        kind: MotionFault = MotionFault.FROZEN,
    ) -> float | None:
        """Drive at `speed` [m/s]; return the time until a fault is noticed, if it is [s].

        A sensor of another `scale` shows so many times the motion.
        """
        for number in range(round(seconds / PERIOD)):
            self.check.model.commanded(self._moment, Command(speed, 0.0))
            self._moment += PERIOD
            self._places.append(self._places[-1] + speed * PERIOD)
            shown = self._seen if frozen else scale * self._places.pop(0)
            moved, self._seen = shown - self._seen, shown
            self.check.saw(self._moment, Travel(moved, 0.0, complex(moved)))
            doubt = self.check.state.doubt
            if doubt is not None and doubt.kind is kind:
                return (number + 1) * PERIOD
        return None


@given(st.sampled_from((0.0, 0.05, 0.1, 0.2)), st.floats(0.1, 0.6))
def test_odometry_that_freezes_as_the_robot_turns_back_is_noticed(delay: float, forward: float) -> None:
    """With a delay of 0.5 s it would have gone forward first, and then it would have been seen there."""
    robot = Straight(delay)
    assert robot.drive(SPEED, 2.0 + forward) is None
    noticed = robot.drive(-SPEED, 3.0, frozen=True)
    assert noticed is not None
    assert noticed <= 1.2


@given(st.integers(0, 2**32), st.sampled_from((0.0, 0.1, 0.2, 0.35)))
def test_odometry_that_follows_random_commands_is_not_frozen(seed: int, delay: float) -> None:
    random, robot = Random(seed), Straight(delay)
    for _ in range(40):
        speed = random.choice((-SPEED, 0.0, SPEED, random.uniform(-SPEED, SPEED)))
        assert robot.drive(speed, random.uniform(0.05, 1.2)) is None


@pytest.mark.parametrize("speed", [0.02, 0.05, 0.1, 0.2])
@pytest.mark.parametrize("scale", [2.0, 3.0, 10.0])
def test_sensor_with_wrong_scale_is_noticed_at_any_speed(speed: float, scale: float) -> None:
    """Each short leg of it is plausible: at 0.05 m/s it was never noticed."""
    robot = Straight(0.1)
    noticed = robot.drive(speed, 1.0 / speed, scale=scale, kind=MotionFault.CARRIED)
    assert noticed is not None
    assert speed * noticed < 0.25


@given(st.integers(0, 2**32), st.sampled_from((0.0, 0.1, 0.2, 0.35)))
def test_odometry_that_follows_random_commands_is_not_carried(seed: int, delay: float) -> None:
    random, robot = Random(seed), Straight(delay)
    for _ in range(40):
        speed = random.choice((-SPEED, 0.0, SPEED, random.uniform(-SPEED, SPEED)))
        duration = random.uniform(0.05, 1.2)
        assert robot.drive(speed, duration, scale=1.1, kind=MotionFault.CARRIED) is None
