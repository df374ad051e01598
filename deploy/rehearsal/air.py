"""The network between machines: loss, delay, copies, queues and cuts, drawn from one seed."""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

HOP_DELAY = 0.0005
"""Shortest delay between two machines [s]."""
HOP_JITTER = 0.0015
"""Without faults delays are longer than that by up to this [s], and messages of a link keep their order."""
ORDER_GAP = 1e-9
"""Least time between two messages of a link that would have overtaken each other [s]: more than rounding."""
LOCAL_DELAY = 0.0003
"""Delay between two processes of one machine [s]."""
MAX_QUEUE_TIME = 3.0
"""Longest time in the queue of a link of limited bandwidth [s]; later messages are lost."""


class Weather(NamedTuple):
    """What disturbs the links of some machines."""

    loss: float = 0.0
    """Share of messages that is lost."""
    delay: float = 0.0
    """Added to every delay [s]."""
    jitter: float = 0.0
    """Greatest further delay [s]; messages overtake each other."""
    twice: float = 0.0
    """Share of messages that arrives twice."""
    again: float = 0.0
    """How much later a copy of each message arrives [s]; 0 if none does."""
    growth: float = 0.0
    """Rate at which the delay grows from `since` on [s/s]."""
    since: float = 0.0
    """[s]"""
    bandwidth: float = math.inf
    """[bytes/s]"""


class Air:
    """Every link between two machines."""

    def __init__(self, seed: int, now: Callable[[], float], weather: Weather) -> None:
        """`weather` is that of all links, always; `now` returns the time [s]."""
        self._seed, self._now, self._always = seed, now, weather
        self._chances: dict[str, random.Random] = {}  # one each, so that the monitor does not change a run
        self._local: dict[str, list[Weather]] = {}
        self._deaf: Counter[tuple[str, str]] = Counter()
        self._free_at: dict[tuple[str, str], float] = {}
        self._hopped: dict[tuple[str, str], float] = {}  # when the newest message of a link has arrived [s]

    @property
    def undisturbed(self) -> bool:
        """Whether nothing disturbs all links."""
        return self._always == Weather()

    def disturb(self, machine: str, weather: Weather) -> None:
        """Add `weather` to all links of `machine`."""
        self._local.setdefault(machine, []).append(weather)

    def calm(self, machine: str, weather: Weather) -> None:
        """Take `weather` away again."""
        self._local[machine].remove(weather)

    def cut(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Lose everything from the first to the second machine of each pair."""
        self._deaf.update(pairs)

    def mend(self, pairs: Iterable[tuple[str, str]]) -> None:
        """End one cut of each pair."""
        self._deaf.subtract(pairs)

    def ways(self, sender: str, receiver: str, size: int) -> Iterator[float]:
        """Yield the delay of each copy of a message of `size` bytes that arrives [s]."""
        if sender == receiver:
            yield LOCAL_DELAY
            return
        if self._deaf[sender, receiver] > 0:
            return
        disturbed = (self._always, *self._local.get(sender, ()), *self._local.get(receiver, ()))
        chance = self._chance(receiver)
        if any(one.loss > 0.0 and chance() < one.loss for one in disturbed):
            return
        queue = self._queued(sender, receiver, size, min(one.bandwidth for one in disturbed))
        if queue > MAX_QUEUE_TIME:
            return
        copies = 1 + any(one.twice > 0.0 and chance() < one.twice for one in disturbed)
        for _ in range(copies):
            extra = sum(
                one.delay + one.jitter * chance() + one.growth * (self._now() - one.since)
                for one in disturbed
            )
            duration = self._hop(sender, receiver, chance()) + extra + queue
            yield duration
            yield from (duration + one.again for one in disturbed if one.again > 0.0)

    def _hop(self, sender: str, receiver: str, chance: float) -> float:
        """Return the delay without faults [s], after that of the message before."""
        now, link = self._now(), (sender, receiver)
        hop = max(HOP_DELAY + HOP_JITTER * chance, self._hopped.get(link, 0.0) + ORDER_GAP - now)
        self._hopped[link] = now + hop
        return hop

    def _chance(self, receiver: str) -> Callable[[], float]:
        """Return what draws the fate of messages to `receiver`."""
        chance = self._chances.get(receiver)
        if chance is None:
            chance = self._chances[receiver] = random.Random(f"air {self._seed} {receiver}")
        return chance.random

    def _queued(self, sender: str, receiver: str, size: int, bandwidth: float) -> float:
        """Return how long a message waits for those before it, and for its own last byte [s]."""
        if bandwidth == math.inf:
            return 0.0
        now = self._now()
        begins = max(now, self._free_at.get((sender, receiver), now))
        queue = begins + size / bandwidth - now
        if queue <= MAX_QUEUE_TIME:
            self._free_at[sender, receiver] = now + queue
        return queue
