"""Probes: small motions of a robot that does not move as commanded."""

from __future__ import annotations

from random import Random

import pytest

from formation.agent.pose.motion_check import Disagreement
from formation.agent.pose.motion_model import Modelled
from formation.agent.pose.probe import LEAST_PRECISE_TIME, MAX_PROBE_TIME, MIN_AVERAGING_TIME, Phase, Probe
from formation.control.controller import Limits
from formation.control.observer import Travel
from formation.control.unicycle import AT_REST, Command
from formation.protocol.status import MotionFault
from tests.support.examples import slow

DOUBT = Disagreement(MotionFault.SPEEDS, 0.1, 0.0, 0.4)
WANTED = Command(0.2, 0.0)
PERIOD = 0.05


def stepped(probe: Probe, begin: float, seconds: float, *, room: bool) -> float:
    """Step the probe; with `room` the robot drives as commanded. Return the path that it asked for [m]."""
    ahead = path = 0.0
    for step in range(round(seconds / PERIOD)):
        moment = begin + step * PERIOD
        model = Modelled(moment, ahead + 0j, 1.0 + 0j, ahead, 0.0, abs(ahead), 0.0)
        probe.verdict(moment, DOUBT, 1.0, speeds=False)
        command = probe.step(moment, DOUBT, model, WANTED)
        path += PERIOD * command.speed
        ahead += PERIOD * command.speed if room else 0.0
    return path


@pytest.mark.parametrize("room", [True, False])
def test_probe_without_room_counts_as_blocked(*, room: bool) -> None:
    probe = Probe(Limits(offset=0.1, max_speed=0.6, max_turn_rate=2.0), AT_REST, 0.4)
    assert stepped(probe, 0.0, 2.0 + MAX_PROBE_TIME, room=room) > 0.0
    assert probe.state.blocked is not room


def test_probe_after_one_without_room_goes_the_other_way() -> None:
    probe = Probe(Limits(offset=0.1, max_speed=0.6, max_turn_rate=2.0), AT_REST, 0.4)
    assert stepped(probe, 0.0, 7.0, room=False) > 0.0
    assert stepped(probe, 7.0, 8.0, room=False) < 0.0
    assert stepped(probe, 15.0, 20.0, room=True) > 0.0


def seen_after(tries: int, noise: float, *, frozen: bool) -> bool:
    """Whether the probe after so many is seen by a sensor with `noise` [m; standard deviation per axis]."""
    probe, random = Probe(Limits(offset=0.1, max_speed=0.2, max_turn_rate=2.0), AT_REST, 0.4), Random(tries)
    probe.state.tries = tries
    moment = ahead = last = 0.0
    while moment < 2.0 ** (tries + 2) + 10.0:
        model = Modelled(moment, ahead + 0j, 1.0 + 0j, ahead, 0.0, abs(ahead), 0.0)
        now = random.gauss(0.0 if frozen else ahead, noise)
        probe.saw(moment, Travel(now - last, 0.0, complex(now - last)), model)
        last = now
        seen = probe.verdict(moment, DOUBT, 1.0, speeds=False)
        if seen is not None:
            return seen
        ahead += PERIOD * probe.step(moment, DOUBT, model, WANTED).speed
        moment += PERIOD
    raise AssertionError("no probe ends")


@pytest.mark.parametrize("tries", [0, 8, *slow(6, 7, 10)])
def test_noise_of_2_mm_hides_no_probe_however_short(tries: int) -> None:
    assert seen_after(tries, 0.002, frozen=False)
    assert not seen_after(tries, 0.002, frozen=True)


@pytest.mark.parametrize("tries", [3, 8, 12])
def test_probe_of_a_precise_sensor_takes_no_longer_later(tries: int) -> None:
    probe = Probe(Limits(offset=0.1, max_speed=0.2, max_turn_rate=2.0), AT_REST, 0.4)
    probe.state.tries = tries
    model = Modelled(0.0, 0j, 1.0 + 0j, 0.0, 0.0, 0.0, 0.0)
    phases = []
    for step in range(round((2.0**tries + 3.0) / PERIOD)):
        probe.saw(step * PERIOD, Travel(0.0, 0.0, 0j), model)
        probe.step(step * PERIOD, DOUBT, model, WANTED)
        phases.append(probe.state.phase)
    assert MIN_AVERAGING_TIME <= phases.count(Phase.BEFORE) * PERIOD <= LEAST_PRECISE_TIME + 2.0 * PERIOD


def test_probe_with_room_and_rearming_end_the_blockage() -> None:
    probe = Probe(Limits(offset=0.1, max_speed=0.6, max_turn_rate=2.0), AT_REST, 0.4)
    blocked = []
    for begin, seconds, room in ((0.0, 7.0, False), (7.0, 8.0, True), (15.0, 20.0, False)):
        stepped(probe, begin, seconds, room=room)
        blocked.append(probe.state.blocked)
    probe.rearm()
    assert [*blocked, probe.state.blocked] == [True, False, True, False]
