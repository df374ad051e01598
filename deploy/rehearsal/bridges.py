"""Faults between a robot and its agent: a bridge that repeats measurements, a driver that restarts."""

from __future__ import annotations

from dataclasses import replace

from formation.deploy.rehearsal.fleet import Fleet
from formation.ros2.messages import Odometry, decode, encode
from formation.topics import ODOM, POSE


def repeat(fleet: Fleet, name: str, delay: float) -> None:
    """Have the measurements of a robot's place arrive again after `delay` [s], or not any more if it is 0."""
    for topic in (ODOM, POSE):
        fleet.local.repeats[topic.key(name)] = delay


def restart(fleet: Fleet, name: str) -> None:
    """Have a robot's odometry count from where it is as zero."""
    fleet.local.changes[ODOM.key(name)] = Restarted().changed


class Restarted:
    """Odometry that counts from the first message on."""

    def __init__(self) -> None:
        self._zero: Odometry | None = None

    def changed(self, payload: bytes) -> bytes:
        """The message as the restarted driver sends it."""
        odometry = decode(Odometry, payload)
        zero = self._zero = self._zero or odometry
        back = zero.heading.conjugate()
        position, heading = back * (odometry.position - zero.position), back * odometry.heading
        return encode(replace(odometry, position=position, heading=heading))
