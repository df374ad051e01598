"""What the tests of the bus share: a linked pair, and waiting for what must come."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from formation.topics import CMD_VEL, ODOM, ORDER, POSITION
from formation.transport.bus import Bus
from formation.transport.mailbox import Reply
from formation.wire import Sample
from tests.support.child import PATIENCE, until

ODOMETRY, COMMAND, PLACE, REQUESTED = (topic.key("robot1") for topic in (ODOM, CMD_VEL, POSITION, ORDER))


@contextmanager
def serving(bus: Bus) -> Iterator[None]:
    """Another process's main loop, played by a thread."""
    over = threading.Event()

    def loop() -> None:
        while not over.is_set():
            bus.wait(PATIENCE)
            bus.mailbox.serve()

    thread = threading.Thread(target=loop, name="another process")
    thread.start()
    try:
        yield
    finally:
        over.set()
        bus.mailbox.wake()
        thread.join()


def collect(bus: Bus, number: int) -> list[Sample]:
    samples: list[Sample] = []
    while len(samples) < number:
        assert bus.wait(PATIENCE), f"{len(samples)} of {number} came"
        samples += bus.drain()
    return samples


def answers(bus: Bus, key: str, payload: bytes, number: int) -> list[Reply]:
    """The answers of `number` others, asked again until `bus` knows of them all."""
    replies: list[Reply] = []

    def all_answered() -> bool:
        replies[:] = bus.ask(key, payload, PATIENCE)
        return len(replies) == number

    until(all_answered)
    return replies


def acquaint(here: Bus, there: Bus) -> None:
    """Wait until `there` knows of all that `here`, linked with it, has declared before."""
    here.subscribe(PLACE)
    there.advertise(POSITION, PLACE)
    until(lambda: there.watched(PLACE))
