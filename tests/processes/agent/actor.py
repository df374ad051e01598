"""A fleet that a test plays over real Zenoh, and the real monitor that watches it."""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mcap.reader import make_reader

from formation.mission.file import load
from formation.monitor.metrics.keys import watched
from formation.monitor.recording.channels import SUFFIX
from formation.monitor.recording.reader import read
from formation.topics import GROUND_TRUTH, STATUS
from formation.transport.bus import Bus, BusConfig
from formation.wire import Sample
from tests.support.child import PATIENCE, Child, free_endpoint, started
from tests.support.monitored import Fleet, command, odometry, status

KEYS = watched(load("six_robots"))


class Actor:
    """A fleet in formation that publishes all messages of a real one, in real time, and keeps them.

    Agents and leader publish on `bus`, simulated robots on `stage`, where they are the router. The sender
    loses nothing: messages wait until the network takes them.
    """

    def __init__(self, bus: Bus, stage: Bus) -> None:
        self.bus, self.stage = bus, stage
        self.fleet, self.sent = Fleet(epoch=time.time()), list[Sample]()
        self.held_up = 0.0
        """Longest time by which it was late with a message [s]."""
        for one in KEYS:
            self.bus_of(one.key).advertise(one.topic, one.key, waits=True)

    def bus_of(self, key: str) -> Bus:
        """Return the bus on which a key is published."""
        return self.stage if key.endswith(GROUND_TRUTH.name) else self.bus

    @property
    def published(self) -> Counter[str]:
        return Counter({**self.bus.published, **self.stage.published})

    def wait_for_monitor(self) -> None:
        last = [one.key for one in KEYS if one.topic in {STATUS, GROUND_TRUTH}]
        deadline = time.monotonic() + PATIENCE
        while not all(self.bus_of(key).watched(key) for key in last):
            assert time.monotonic() < deadline, "no monitor listens"
            time.sleep(0.01)

    def wait_until_recorded(self, path: Path) -> None:
        """Wait until the recording has everything that was sent; it is written twice a second.

        A monitor that ends waits only briefly for messages that a busy machine has not sent yet.
        """
        deadline = time.monotonic() + PATIENCE
        while self.published - read(path).extent().counts:
            assert time.monotonic() < deadline, self.published - read(path).extent().counts
            time.sleep(0.05)

    def play(self, seconds: float) -> None:
        """Publish 20 periods a second, each robot at its own phase.

        Like robots, it does not catch up after a stall of the machine: the rest comes later, so no position
        is as old as the stall was long.
        """
        epoch, period = self.fleet.epoch, 0.05
        start = time.time() - epoch
        for tick in range(round(seconds / period)):
            for robot in self.fleet.mission.names:
                late = time.time() - epoch - start - (tick + self.fleet.phase(robot)) * period
                self.held_up = max(self.held_up, late)
                if late > period:
                    start, late = start + late, 0.0
                at = start + (tick + self.fleet.phase(robot)) * period
                time.sleep(max(0.0, -late))
                for sample in self._period(robot, at, with_status=tick % 10 == 0):
                    self.bus_of(sample.key).publish(sample.key, sample.payload, sample.attachment)
                    self.sent.append(sample)

    def _period(self, robot: str, at: float, *, with_status: bool) -> Iterator[Sample]:
        yield self.fleet.position(robot, at)
        if with_status:
            yield status(robot, at, "run", "in formation control", self.fleet.epoch)
        if robot != self.fleet.mission.leader:
            yield odometry(robot, at, self.fleet.epoch)
            yield command(robot, at, 0.2, 0.1)
            yield self.fleet.truth(robot, at, turned=0.05)


@contextmanager
def watching(*flags: str) -> Iterator[tuple[Child, Actor]]:
    """Start a monitor and the fleet that it watches; yield both when ready."""
    end, stage_end = free_endpoint(), free_endpoint()
    with (
        Bus(BusConfig(listen=(end,))) as bus,
        router(stage_end) as stage,
        started(
            "formation.monitor", "six_robots", "-e", end, "--stage", stage_end, "--no-page", *flags
        ) as child,
    ):
        assert child.event("ready") == {
            "event": "ready", "process": "monitor", "page": None, "foxglove": None,
        }  # fmt: skip
        actor = Actor(bus, stage)
        actor.wait_for_monitor()
        yield child, actor


def router(endpoint: str) -> Bus:
    """Open a bus that is a router, as simulated robots or ROS 2 have one."""
    return Bus(BusConfig(listen=(endpoint,), mode="router"))


def recorded(path: Path) -> dict[str, list[bytes]]:
    """Return the payloads in a recording, by key."""
    found: dict[str, list[bytes]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            if not channel.topic.endswith(SUFFIX):
                found.setdefault(channel.topic.removeprefix("/"), []).append(message.data)
    return found


def events(child: Child) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return all snapshots, and the summary."""
    lines = iter(lambda: child._lines.get(timeout=PATIENCE), None)
    *snapshots, summary = map(json.loads, filter(None, lines))
    assert {one["event"] for one in snapshots} <= {"snapshot"}
    assert summary["event"] == "summary"
    return snapshots, summary
