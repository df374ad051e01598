"""The paper's own architecture: one node that hears every robot's odometry and commands them all.

python -m tests.bench.central PLAN

It is a peer of the agents, for comparison only: the same observers, tracks and law from the same code, put
together for a whole fleet in one process. What agents tell each other over the network it has in its own
memory, one track of each robot for all who measure it, and it commands a robot as soon as its odometry is
there. It has none of an agent's failsafe table but the last line: who has nobody to follow stands still.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from agent.commander import AT_REST, Commander
from agent.localisation import Localisation
from agent.neighbourhood import Neighbour, Neighbourhood
from agent.orders import Orders
from agent.slots import Slots
from formation import order
from formation.law import LAWS
from formation.mission import Mission
from formation.mission_file import load
from formation.order import Told
from formation.ros2.messages import Odometry, Pose, decode
from formation.topics import CMD_VEL, ODOM, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.process import clocks, say
from formation.unicycle import Command
from formation.wire import BadMessage, Now, Outgoing, Sample

WATCH = 0.5
"""How often it looks whether its parent is there [s]."""


class Driven:
    """One robot, as the node knows it."""

    def __init__(self, mission: Mission, name: str, tracks: dict[str, Neighbour]) -> None:
        """`tracks` has everybody's, shared by all who measure them."""
        kind = mission.law.kind
        self.commander = Commander(mission, name, kind)
        self._here, self._slots = Localisation(mission, name, kind), Slots(mission, name)
        self._around, self._track = Neighbourhood(mission, name, kind), tracks[name]
        self._around.each = {other: tracks[other] for other in self._around.each}
        self._law, self._gains, self._limits = LAWS[kind], mission.law.gains, mission.robots[name].limits
        self._integral = 0j

    def see(self, sample: Sample, orders: Orders, now: Now) -> Command:
        """Its command upon its odometry. Raises BadMessage."""
        here, around, wanted = self._here, self._around, orders.newest
        dt = here.take(decode(Odometry, sample.payload), sample.arrived, now) or 0.0
        self._track.take_position(Pose(here.stream.stamp, here.position, here.heading), sample.arrived, now)
        around.choose(now)
        if wanted is None or wanted.mode != "run" or not around.guides or not here.follows:
            return AT_REST
        self._slots.follow(wanted, orders.rose, now.mono)
        what = around.measured(here, self._slots, now)
        command, self._integral = self._law(
            self._integral, here.heading, what, self._gains, self._limits, min(dt, here.stream.limit)
        )
        return command


class Central:
    """The controller of a whole fleet, without a clock or a socket."""

    def __init__(self, mission: Mission) -> None:
        self._tracks = {name: Neighbour(mission, name, mission.robots[name].rate) for name in mission.names}
        self._driven = {ODOM.key(name): Driven(mission, name, self._tracks) for name in mission.followers}
        self._leader, self._leads = POSITION.key(mission.leader), mission.leader
        self._orders = Orders(mission)
        self.dropped = 0
        """Messages that were not used."""

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Every key it listens to: all robots' odometry, and the leader."""
        return (self._leader, *self._driven)

    def step(self, now: Now, inbox: Sequence[Sample]) -> Iterator[Outgoing]:
        """Each robot's command as soon as it is made."""
        for sample in inbox:
            try:
                if sample.key == self._leader:
                    self._follow(sample, now)
                else:
                    driven = self._driven[sample.key]
                    yield driven.commander.say(now, driven.see(sample, self._orders, now))[0]
            except BadMessage:
                self.dropped += 1

    def _follow(self, sample: Sample, now: Now) -> None:
        told = order.decode(Told, sample.attachment or b"")
        if told.order is not None:
            self._orders.hear(told.order, self._leads, sample.arrived, now)
        self._tracks[self._leads].take_position(decode(Pose, sample.payload), sample.arrived, now)


def main(plan: dict[str, Any]) -> None:
    """Drive everybody until the parent is gone; the plan has the mission's file and all endpoints to dial."""
    mission, parent = load(plan["mission"]), os.getppid()
    central = Central(mission)
    with Bus(BusConfig(connect=tuple(plan["dial"])), capacity=8192) as bus:
        for name in mission.followers:
            bus.advertise(CMD_VEL, CMD_VEL.key(name))
        for key in central.subscriptions:
            bus.subscribe(key)
        say("ready")
        while os.getppid() == parent:
            bus.send(central.step(clocks(), bus.drain()))
            bus.wait(WATCH)


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))
