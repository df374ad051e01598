"""The paper's own architecture: one node that hears every robot's odometry and commands them all.

python -m tests.campaigns.bench.central PLAN

It is a peer of the agents, for comparison only: the same observers, tracks and law from the same code, put
together for a whole fleet in one process. What agents tell each other over the network it has in its own
memory, one track of each robot for all that measure it, and it commands a robot as soon as its odometry is
there. It has none of an agent's failsafe table but the last line: a robot with none to follow stands still.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from formation.agent.following.neighbour import Neighbour
from formation.agent.following.neighbours import Neighbourhood
from formation.agent.following.orders import Orders
from formation.agent.following.slots import Slots
from formation.agent.pose.estimator import Localisation
from formation.agent.safety.commander import Commander
from formation.control.pipeline import Inputs, control_step
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.ros2.messages import Odometry, Pose, decode
from formation.topics import CMD_VEL, ODOM, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import clocks, say
from formation.wire import BadMessage, Now, Outgoing, Sample

WATCH = 0.5
"""How often it looks whether its parent is there [s]."""


class Driven:
    """One robot, as the node knows it."""

    def __init__(self, mission: Mission, name: str, tracks: dict[str, Neighbour]) -> None:
        """`tracks` has those of all, shared by all that measure them."""
        law = mission.law.controller
        self._commander = Commander(mission, name)
        self._here, self._slots = Localisation(mission, name, law), Slots(mission, name)
        self._around, self._track = Neighbourhood(mission, name, law), tracks[name]
        self._around.each = {other: tracks[other] for other in self._around.each}
        self._gains, self._params = mission.gains, mission.control(name, law)
        self._integral = 0j

    def process_sample(self, sample: Sample, orders: Orders, now: Now) -> list[Outgoing]:
        """Its command upon its odometry. Raises BadMessage."""
        here, around, wanted = self._here, self._around, orders.newest
        dt = here.update_pose(decode(Odometry, sample.payload), sample.arrived, now) or 0.0
        self._track.take_position(
            Pose(here.stream.state.stamp, here.state.position, here.heading), sample.arrived, now
        )
        around.choose(now)
        if wanted is None or wanted.mode != "run" or not around.guides or not here.state.follows:
            return self._commander.rest(now)
        self._slots.follow(wanted, orders.state.rose, now.mono)
        what = around.measured(here, self._slots, now)
        dt = min(dt, here.stream.limit)
        inputs = Inputs(now.mono, dt, here.heading, what, self._gains)
        state, outcome = control_step(self._commander.control_state(self._integral), inputs, (), self._params)
        self._integral = state.integral
        return self._commander.say(now, outcome.command, state)


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
                    yield self._driven[sample.key].process_sample(sample, self._orders, now)[0]
            except BadMessage:
                self.dropped += 1

    def _follow(self, sample: Sample, now: Now) -> None:
        attachment = json_message.decode(PositionAttachment, sample.attachment or b"")
        if attachment.order is not None:
            self._orders.receive(attachment.order, self._leads, sample.arrived, now)
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
