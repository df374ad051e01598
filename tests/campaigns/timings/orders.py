"""An operator's console on the fake clock, and scenarios in which orders are lost, late or repeated.

python -m tests.campaigns.timings.orders [TIMINGS]

Each scenario runs at so many random timings (1000) and raises AssertionError where a robot loses a stop or a
hold, or is set going by anything but ``run``. The console is the production one: only its clock and its
network are made up.
"""

from __future__ import annotations

import heapq
import itertools
import json
import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest.mock import patch

from formation.agent.persistence.restore import Restorer
from formation.agent.status import Surroundings
from formation.mission.file import parse
from formation.protocol import json_message
from formation.protocol.outcome import Outcome
from formation.protocol.request import OperatorReply, OperatorRequest
from formation.protocol.status import AgentState
from formation.stability import intent
from formation.topics import ORDER
from formation.transport import asking
from formation.transport.mailbox import Reply
from formation.wire import Now
from tests.campaigns.figures import worded
from tests.support.fleet import EPOCH, Fleet

MISSION = parse(
    """
name = "ordered"
leader = "led"
takeover = 1.0
[standbys.deputy]
[robot]
rate = 5
[shapes.row]
a = [-1.0, 0.5]
b = [-1.0, -0.5]
c = [-2.0, 0.0]
[robots.led]
start = { x = 0.0, y = 0.0 }
[robots.a]
neighbours = ["led", "b"]
start = { x = -1.1, y = 0.5 }
[robots.b]
neighbours = ["led", "a"]
start = { x = -1.1, y = -0.5 }
[robots.c]
neighbours = ["a", "b"]
start = { x = -2.1, y = 0.0 }
[[route]]
speed = 0.1
heading_deg = 0
"""
)
LEADER = "leader"
"""What the fleet calls the leader's process."""
PARTIES = (LEADER, "deputy", *MISSION.followers)


@dataclass
class OpenQuestion:
    """A question on its way, and its answers."""

    replies: list[Reply] = field(default_factory=list)
    over: bool = False


class Console:
    """Gives orders to a fleet as the command line does, over a network of its own."""

    def __init__(self, fleet: Fleet, draw: random.Random) -> None:
        self.fleet, self.draw = fleet, draw
        self.away: set[str] = set()
        """Processes that no request reaches."""
        self.slowest = 0.05
        """Longest way of a request or an answer [s]."""
        self.received: list[bytes] = []
        """Every request that was put."""
        self.obliged: set[str] = set()
        """Robots that acknowledged a stop or a hold, and no ``run`` since."""
        self._serial = itertools.count()
        self._flight: list[tuple[float, int, Callable[[], None]]] = []

    def give(self, do: str, seconds: float = 1.0) -> Outcome:
        """Give an order, and go on until everybody has answered, for at most so long [s]."""
        request = intent.request_for(MISSION, do)
        if do == "run":
            self.obliged.clear()
        with self._in_virtual_time():
            outcome = asking.give(self.put, asking.addressed(MISSION, do), request, seconds)
        if do in {"stop", "hold"}:
            obey = {name for name, one in outcome.answers.items() if one.reply.ok}
            self.obliged |= obey & set(MISSION.followers)
        self.check()
        return outcome

    def run(self, seconds: float) -> None:
        """Let time pass. Raises AssertionError as soon as a robot at rest is set going."""
        end = self.fleet.now + seconds
        while self._flight and self._flight[0][0] <= end:
            when, _, happens = heapq.heappop(self._flight)
            self.fleet.run(max(when - self.fleet.now, 0.0))
            happens()
            self.check()
        self.fleet.run(max(end - self.fleet.now, 0.0))
        self.check()

    def check(self) -> None:
        for name in self.obliged:
            agent = self.fleet.agents[name]
            runs = self.fleet.nodes[name].alive and agent.decision.state is AgentState.RUN
            # where its latch is closed, its next step will obey
            assert not runs or agent.latch.mode is not None, f"{name} was set going at {self.fleet.now:.2f} s"

    def put(self, key: str, payload: bytes, timeout: float) -> OpenQuestion:
        """On the way to all that `key` addresses."""
        requested = OpenQuestion()
        self.received.append(payload)
        for name in self._addressed(key):
            if name not in self.away:
                self._send(name, payload, requested)
        self._later(timeout, lambda: setattr(requested, "over", True))
        return requested

    def repeat(self, payload: bytes) -> None:
        """A network that sends an old request once more, to everybody."""
        for name in PARTIES:
            self._send(name, payload, OpenQuestion())

    def _send(self, name: str, payload: bytes, requested: OpenQuestion) -> None:
        self._later(self.draw.uniform(0.001, self.slowest), lambda: self._arrive(name, payload, requested))

    def _arrive(self, name: str, payload: bytes, requested: OpenQuestion) -> None:
        node = self.fleet.nodes[name]
        if not node.alive:
            return
        reply: bytes = node.core.request(payload, self.fleet.now)  # type: ignore[attr-defined]
        result = json_message.decode(OperatorReply, reply)
        answer = Reply(ORDER.key(result.robot), reply, 1.0)
        self._later(self.draw.uniform(0.001, self.slowest), lambda: requested.replies.append(answer))

    def _addressed(self, key: str) -> Iterable[str]:
        if key == ORDER.pattern.format(robot="*"):
            return PARTIES
        name = key.partition("/")[0]
        return (LEADER if name == MISSION.leader else name,)

    def _later(self, wait: float, happens: Callable[[], None]) -> None:
        heapq.heappush(self._flight, (self.fleet.now + wait, next(self._serial), happens))

    @contextmanager
    def _in_virtual_time(self) -> Iterator[None]:
        class Clock:
            time = staticmethod(lambda: EPOCH + self.fleet.now)
            sleep = staticmethod(self.run)

        with (
            patch.object(asking, "_now", lambda: self.fleet.now),
            patch.object(asking, "time", Clock),
            patch.object(asking, "CHECK_PERIOD", 0.02),
        ):
            yield


def restart(fleet: Fleet, name: str) -> None:
    """A new process, which finds what an agent's has kept."""
    if name in fleet.candidates:
        fleet.restart(name)
        return
    kept = json.dumps(Restorer(fleet.agents[name], "boot").stops).encode()
    fleet.restart(name)
    now = Now(fleet.now, EPOCH + fleet.now)
    Restorer(fleet.agents[name], "boot").take_stops(kept, now, "stops")


def driving(draw: random.Random) -> Console:
    """A team under way for a random while."""
    fleet = Fleet(MISSION, seed=draw.randrange(10**6))
    console = Console(fleet, draw)
    console.run(2.5 + draw.random())
    assert states(fleet) == {AgentState.RUN}
    return console


def states(fleet: Fleet) -> set[AgentState]:
    return {agent.decision.state for agent in fleet.agents.values()}


def ends_well(console: Console) -> None:
    """All links are back: what is stopped is released, no robot moves before ``run``, and then all do."""
    fleet = console.fleet
    fleet.heal()
    console.away, console.slowest = set(), 0.02
    console.run(2.5)
    for _ in range(3):
        if console.give("release", 2.0).obeyed:
            break
        console.run(0.5)
    console.run(1.0)
    for _ in range(5):
        console.give("run", 2.0)
        console.run(2.0)
        if states(fleet) == {AgentState.RUN}:
            return
    raise AssertionError(f"after run: {fleet.agents['a'].decision}, leader {fleet.in_charge.mode}")


def hold_survives_a_cut_leader(draw: random.Random) -> None:
    """The leader is cut off around a hold, and the deputy takes its place: no robot is set going."""
    console = driving(draw)
    fleet, others = console.fleet, [name for name in PARTIES if name != LEADER]
    cut = draw.uniform(-1.2, 1.2)
    if cut <= 0.0:
        fleet.cut([LEADER], others)
        console.run(-cut)
    else:
        console._later(cut, lambda: fleet.cut([LEADER], others))
    if draw.random() < 0.3:
        console.away = {draw.choice(PARTIES)}
    console.give("hold", 1.5)
    console.run(draw.uniform(2.0, 4.0))
    assert len(console.obliged) >= len(MISSION.followers) - 1
    assert fleet.leader_terms[-1].name == "deputy"
    if draw.random() < 0.3:
        restart(fleet, draw.choice(MISSION.followers))
        console.run(2.0)
    ends_well(console)


def release_starts_nothing(draw: random.Random) -> None:
    """Stops, holds and releases that miss a party each, restarts, and old requests that come again."""
    console = driving(draw)
    first = ["hold", "stop", "release", "release"] if draw.random() < 0.5 else ["stop", "release"]
    more = [draw.choice(["stop", "hold", "release", "release", "restart", "repeat"]) for _ in range(4)]
    for do in (*first, *more):
        lost = draw.choice([*PARTIES, "", ""])
        console.away = {lost} - {""}
        if do == "restart":
            restart(console.fleet, draw.choice(PARTIES))
        elif do == "repeat":
            console.repeat(draw.choice(console.received))
        else:
            console.give(do, 0.4)
        console.run(draw.choice([0.0, 0.02, 0.3, 1.5]))
    ends_well(console)


def run_before_a_stop_is_void(draw: random.Random) -> None:
    """A ``run`` and a ``release`` of one operator, however late, end no stop and no hold of another."""
    console = driving(draw)
    fleet, others = console.fleet, Console(console.fleet, draw)
    console.give("hold")
    if draw.random() < 0.5:
        console.give("stop")
        console.give("release")
    console.give("run", 0.3)
    old = [
        one for one in console.received if json_message.decode(OperatorRequest, one).do in {"release", "run"}
    ]
    console.run(draw.uniform(0.0, 0.5))
    others.give(draw.choice(["stop", "hold"]))
    for _ in range(4):
        others.repeat(draw.choice(old))
        others.run(draw.uniform(0.0, 0.3))
    others.run(1.0)
    assert others.obliged == set(MISSION.followers)
    assert AgentState.RUN not in states(fleet)
    ends_well(others)


def stop_is_acknowledged_where_it_works(draw: random.Random) -> None:
    """Robots without a link or a listener are named as not stopped, and stopped once the link is back."""
    console = driving(draw)
    fleet = console.fleet
    lost = draw.sample(MISSION.followers, draw.randint(1, len(MISSION.followers)))
    around = {name: draw.choice([Surroundings(False, None), Surroundings(True, False)]) for name in lost}
    for name, surroundings in around.items():
        fleet.agents[name].aware(surroundings)
    console.run(draw.uniform(0.0, 0.5))
    outcome = console.give("stop")
    assert sorted(outcome.unreached) == sorted(lost), outcome.summary()
    assert not outcome.obeyed
    assert "NOT STOPPED" in outcome.summary()
    for name in lost:
        fleet.agents[name].aware(Surroundings(True, True))
    console.run(draw.uniform(0.5, 1.5))
    assert states(fleet) == {AgentState.STOP}
    assert console.give("stop").obeyed
    ends_well(console)


SCENARIOS = (
    hold_survives_a_cut_leader,
    release_starts_nothing,
    run_before_a_stop_is_void,
    stop_is_acknowledged_where_it_works,
)


def main() -> int:
    flags = worded(__doc__)
    flags.add_argument("timings", metavar="TIMINGS", nargs="?", type=int, default=1000)
    timings, failed = flags.parse_args().timings, 0
    for scenario in SCENARIOS:
        began, wrong = time.monotonic(), list[str]()
        for seed in range(timings):
            try:
                scenario(random.Random(f"{scenario.__name__} {seed}"))
            except AssertionError as error:
                wrong.append(f"{seed}: {(str(error) or 'assertion').splitlines()[0]}")
        failed += len(wrong)
        well = f"{scenario.__name__}: {timings - len(wrong)} of {timings} ({time.monotonic() - began:.0f} s)"
        print(well, *wrong[:5], sep="\n  ", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
