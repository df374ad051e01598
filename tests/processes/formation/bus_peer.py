"""A process with a bus and no more: ``python -m tests.processes.formation.bus_peer ROLE ENDPOINT``."""

from __future__ import annotations

import os
import sys
import time

import psutil

from formation.topics import ODOM, POSITION
from formation.transport.bus import Bus, BusConfig
from formation.transport.runtime.process import say

ODOMETRY = ODOM.key("robot1")
MESSAGES = 200


def burst(endpoint: str) -> None:
    """Dial, send `MESSAGES` messages as soon as there is a listener, and close at once."""
    with Bus(BusConfig(connect=(endpoint,))) as bus:
        bus.advertise(ODOM, ODOMETRY)
        while not bus.watched(ODOMETRY):
            time.sleep(0.001)
        for number in range(MESSAGES):
            bus.publish(ODOMETRY, number.to_bytes(724, "little"))


def listener(endpoint: str, *overrides: tuple[str, str]) -> None:
    """Listen, subscribe and never drain."""
    with Bus(BusConfig(listen=(endpoint,), overrides=overrides)) as bus:
        bus.subscribe(ODOMETRY)
        say("ready")
        while True:
            time.sleep(60.0)


def patient(endpoint: str) -> None:
    """Do as `listener`, with a lease of a minute: links survive a silence of that length."""
    listener(endpoint, ("transport/link/tx/lease", "60000"))


def failing(endpoint: str) -> None:
    """Fail with a callback subscriber, an unanswered query and traffic under way."""
    with Bus(BusConfig(listen=(endpoint,))) as bus:
        bus.subscribe(ODOMETRY)
        bus.answer(POSITION.key("robot1"), lambda request, _: request)
        say("ready")
        while len(bus.drain()) == 0:
            bus.wait(60.0)
        raise RuntimeError("the main loop failed")


def neighbourly(endpoint: str) -> None:
    """Open an agent's share of links and subscriptions; print how many threads that takes."""
    process = psutil.Process(os.getpid())
    before = process.num_threads()  # numpy has some of its own
    with Bus(BusConfig(connect=(endpoint,), listen=("tcp/127.0.0.1:0",))) as bus:
        for robot in ("robot1", "robot2", "robot3"):
            bus.subscribe(ODOM.key(robot))
            bus.advertise(POSITION, POSITION.key(robot))
        while not bus.drain():
            bus.wait(60.0)
        say("threads", number=process.num_threads() - before)


if __name__ == "__main__":
    role, endpoint = sys.argv[1:]
    roles = (burst, listener, patient, failing, neighbourly)
    next(one for one in roles if one.__name__ == role)(endpoint)
