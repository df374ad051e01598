"""What happens to a formation, in words: snapshots in, events out, without a clock.

An event is a change between two looks. What flaps (a robot at the edge of the radio, an error at the bound)
or floods (rubbish) is told a few times as it happens and then now and then, with a count, so that the list
of events stays one that can be read.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from formation.mission import Mission
from formation.wire import Now
from monitor.figures.event import (
    ERROR,
    FORMATION,
    INFO,
    LAST,
    LONGEST,
    WARNING,
    Event,
    from_message,
    more,
    to_message,
)
from monitor.figures.feed import freshness_limit
from monitor.figures.leading import Leading
from monitor.figures.snapshot import EVADES, RobotFigures, Snapshot
from monitor.figures.turns import Pace, Turns

__all__ = [
    "ERROR", "FORMATION", "INFO", "KINDS", "LAST", "LONGEST", "LOST", "READONLY", "REJECTED", "STATES",
    "WARNING", "Event", "Events", "from_message", "to_message",
]  # fmt: skip
LOST = 1.0
"""A robot whose position has been silent for longer is lost [s]; one that speaks slowly has its own limit."""
UNSETTLED = 1.0
"""What had settled has no longer when the error has been over the bound, or unknown, for so long [s], …"""
RESTLESS = 5.0
"""… or has gone over it again and again for so long [s]."""
REJECTED = 10.0
"""Rejected messages of one kind are told once in so long [s], …"""
KINDS = 8
"""… and of so many kinds in as long."""
STATES = {
    "run": ("runs", INFO),
    "hold": ("held", WARNING),
    "stop": ("stopped", WARNING),
    "waiting": ("waiting", INFO),
}
"""What an agent (or the leader) says of itself, and the event that this makes."""
CLEAR_FOR = 2.0
"""Whose way has been clear for so long [s] gets out of nobody's way any more."""
READONLY = "readonly: would "


class Events:
    """What changes from look to look. Look steadily, several times a second."""

    def __init__(self, mission: Mission) -> None:
        self._robots = [_Robot(name, mission.robots[name].rate) for name in mission.names]
        self._leading = Leading(mission)
        self._settled = _Settled(mission.settled)
        self._rejected = _Rejected(mission)

    def see(self, now: Now, snapshot: Snapshot) -> list[Event]:
        """What has happened since the last look."""
        told = list(self._leading.see(now, snapshot))
        for robot in self._robots:
            told += robot.see(now, snapshot.robots[robot.name], robot.name in snapshot.contested)
            told += robot.relaying(now, forges=robot.name in snapshot.forgers)
        told += self._settled.see(now, snapshot)
        told += self._rejected.see(now, snapshot)
        return told


class _Robot:
    """One robot: is it there, what is it doing, and who speaks for it."""

    def __init__(self, name: str, rate: float) -> None:
        self.name = name
        self._limit = max(LOST, freshness_limit(rate))
        self._joined, self._gone_since = False, 0.0
        self._presence, self._state, self._voices = Turns("lost"), Turns(), Turns("one voice")
        self._aside, self._fallback, self._process = Turns("follows"), Turns(), Turns("1")
        self._stuck = Turns("moves")
        self._evades, self._evaded = Turns("clear"), -math.inf  # and when it last did [s, monotonic]
        self._deadlocks = Turns("0")
        self._relays = Turns("true")

    def see(self, now: Now, robot: RobotFigures, contested: bool) -> Iterator[Event]:
        yield from self._there(now, robot)
        yield from self._doing(now, robot)
        yield from self._following(now, robot)
        yield from self._evading(now, robot)
        before = self._voices.see("a second voice" if contested else "one voice", now.mono)
        if before is not None:
            level = ERROR if contested else INFO
            text = f"its neighbours hear {self._voices.state} speak for it{more(before)}"
            yield Event(now.wall, level, self.name, "contested", text)

    def relaying(self, now: Now, *, forges: bool) -> Iterator[Event]:
        """Whether it relays orders that no leader gave."""
        before = self._relays.see("forged" if forges else "true", now.mono)
        if before is not None:
            level, text = (
                (ERROR, "relays forged orders: others refuse them; take it out of the mission, or stop it")
                if forges
                else (INFO, "relays no forged orders any more")
            )
            yield Event(now.wall, level, self.name, "forged", f"{text}{more(before)}")

    def _there(self, now: Now, robot: RobotFigures) -> Iterator[Event]:
        lost = robot.age is None or robot.age > self._limit
        if lost and robot.age is not None and self._presence.state != "lost":
            self._gone_since = now.mono - robot.age
        away = now.mono - self._gone_since
        before = self._presence.see("lost" if lost else "there", now.mono)
        if before is None:
            return
        if lost:
            stands = self._state.state in {"hold", "stop"}
            said = f"; said last: {self._state.state}" if self._state.state else ""
            text = f"silent for {robot.age:.1f} s{said}{more(before)}"
            yield Event(now.wall, WARNING if stands else ERROR, self.name, "lost", text)
        elif self._joined:
            yield Event(now.wall, INFO, self.name, "back", f"after {away:.1f} s of silence{more(before)}")
        else:
            yield Event(now.wall, INFO, self.name, "joined", f"its position is heard{more(before)}")
        self._joined = True

    def _doing(self, now: Now, robot: RobotFigures) -> Iterator[Event]:
        kind, level = STATES.get(robot.state.removeprefix(READONLY), ("", 0))
        if not kind:  # silent, or not heard of: that is told by its position
            return
        before = self._state.see(robot.state, now.mono)
        if before is not None:
            watching = "read only: " if robot.state.startswith(READONLY) else ""
            text = f"{watching}{robot.reason or robot.state}{more(before)}"
            yield Event(now.wall, level, self.name, kind, text)

    def _following(self, now: Now, robot: RobotFigures) -> Iterator[Event]:
        """Whether it is followed, and whom it measures."""
        before = self._process.see(str(max(robot.voices, 1)), now.mono)
        if before is not None:
            text = f"another process speaks for it from here on{more(before)}"
            yield Event(now.wall, WARNING, self.name, "restarted", text)
        before = self._aside.see("aside" if robot.aside else "follows", now.mono)
        if before is not None:
            why = "" if robot.state == "run" else f": {robot.reason or robot.state}"
            level, text = (
                (WARNING, f"does not follow, others go on without it{why}")
                if robot.aside
                else (INFO, "it follows, and is followed, again")
            )
            yield Event(now.wall, level, self.name, self._aside.state, f"{text}{more(before)}")
        before = self._stuck.see("stuck" if robot.stuck else "moves", now.mono)
        if before is not None:
            level, text = (
                (WARNING, "does not move though it is told to") if robot.stuck else (INFO, "moves again")
            )
            yield Event(now.wall, level, self.name, "stuck", f"{text}{more(before)}")
        before = self._fallback.see(robot.fallback, now.mono)
        if before is not None:
            level, text = INFO, "its own neighbours are back"
            if robot.fallback:
                level, text = WARNING, f"none of its own neighbours is left, it follows {robot.fallback}"
            yield Event(now.wall, level, self.name, "fallback", f"{text}{more(before)}")

    def _evading(self, now: Now, robot: RobotFigures) -> Iterator[Event]:
        """Whether anything is in its way."""
        if robot.evades:
            self._evaded = now.mono
        state = "blocked" if robot.evades == "blocked" else "evades" if robot.evades else "clear"
        if state == "clear" and now.mono - self._evaded < CLEAR_FOR:
            state = self._evades.state
        before = self._evades.see(state, now.mono)
        if before is not None:
            level = WARNING if state == "blocked" else INFO
            text = EVADES.get(robot.evades, "its way is clear again")
            yield Event(now.wall, level, self.name, state, f"{text}{more(before)}")
        before = self._deadlocks.see(str(robot.deadlocks), now.mono)
        if before is not None and robot.deadlocks:
            text = f"kept from moving, it goes another way ({robot.deadlocks} so far){more(before)}"
            yield Event(now.wall, INFO, self.name, "deadlock", text)


class _Settled:
    """Whether the formation stands, with room for an error that touches the bound."""

    def __init__(self, bound: float) -> None:
        self._bound = bound
        self._stands = False
        self._over_since = self._restless_since = math.inf
        self._turns = Turns("unsettled")

    def see(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        self._over_since = _since(snapshot.settled_at is None, self._over_since, now.mono)
        self._restless_since = _since(not snapshot.converged, self._restless_since, now.mono)
        over, restless = now.mono - self._over_since, now.mono - self._restless_since
        if snapshot.converged:
            self._stands = True
        elif over >= UNSETTLED or restless >= RESTLESS:
            self._stands = False
        before = self._turns.see("settled" if self._stands else "unsettled", now.mono)
        if before is not None:
            yield self._event(now, snapshot, more(before))

    def _event(self, now: Now, snapshot: Snapshot, more: str) -> Event:
        bound = f"the bound of {self._bound * 1e3:.0f} mm"
        known = snapshot.known
        if self._stands:
            after = snapshot.settling_time if snapshot.wished_at else None
            wished = "" if after is None else f", {after:.1f} s after what was ordered last"
            # it may touch the bound just when this is told
            since = "" if snapshot.settled_at is None else f" since {snapshot.settled_at:.1f} s"
            text = f"under {bound}{since}{wished}{more}"
            return Event(now.wall, INFO, "", "settled", text)
        if not snapshot.formed:
            return Event(now.wall, INFO, "", "unsettled", f"another figure is on its way{more}")
        is_now = "the error is not known"
        if known.error is not None:
            over = "" if known.complete else f" over {known.words}"
            is_now = f"error {known.error * 1e3:.0f} mm{over}, {bound}"
        return Event(now.wall, WARNING, "", "unsettled", f"{is_now}{more}")


class _Rejected:
    """Messages that were not what they should be: the first of a kind at once, then only how many."""

    def __init__(self, mission: Mission) -> None:
        self._names = frozenset(mission.names)
        self._told: dict[str, int] = {}
        self._next: dict[str, float] = {}
        self._pace = Pace(KINDS, REJECTED / KINDS)

    def see(self, now: Now, snapshot: Snapshot) -> Iterator[Event]:
        due = [
            what
            for what, count in snapshot.rejected.items()
            if count > self._told.get(what, 0) and now.mono >= self._next.get(what, now.mono)
        ]
        for what in sorted(due, key=lambda one: self._next.get(one, 0.0)):  # who waits longest comes first
            if not self._pace.may(now.mono):
                return
            count = snapshot.rejected[what] - self._told.get(what, 0)
            self._told[what], self._next[what] = snapshot.rejected[what], now.mono + REJECTED
            robot = what.partition("/")[0]
            text = f"{what} ({count} messages)" if count > 1 else what
            yield Event(now.wall, WARNING, robot if robot in self._names else "", "rejected", text)


def _since(is_so: bool, since: float, at: float) -> float:
    """Since when it is so [s]; infinite while it is not."""
    return min(since, at) if is_so else math.inf
