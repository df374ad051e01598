"""The faults of a rehearsal: parse, draw and inject them.

Written as ``NAME:KIND[=SIZE]@START[+SECONDS]``, where NAME is a robot, the leader or a standby. Every drawn
fault ends; a fault without SECONDS lasts for ever.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

from formation.agent.simulated import faults as sensed
from formation.agent.simulated.faults import DELAYS, Fault, Size
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.operator import Operator
from formation.mission.model import MAX_HORIZON, Mission
from formation.mission.robot import RobotSpec
from formation.ros2.messages import Odometry, decode, encode
from formation.topics import ODOM, POSE

FIRST_START, LAST_START = 3.0, 25.0
"""Drawn faults start between these times [s]."""
MAX_DRAWN_SECONDS = 10.0
"""A drawn fault lasts at most this long [s]."""
MAX_DRAWN_FAULTS = 5
"""Most faults that are drawn for one run."""
SECOND_RUN_TIME = 10.0
"""Time after the last fault at which an operator orders run again [s].

A hold or a stop that arrives again or late is in force again: robots obey it whenever they receive it. The
longest that a fault keeps a message is 8 s. A robot without usable saved state may hold, too.
"""


class Kind(NamedTuple):
    """One kind of fault."""

    what: str
    """What happens, for people."""
    lowest: float = 0.0
    highest: float = 0.0
    """Range of drawn sizes."""
    robots_only: bool = True
    """Whether only followers have it."""


NETWORK: Mapping[str, Kind] = {
    "loss": Kind("loses this share of its messages", 0.1, 0.9, robots_only=False),
    "delay": Kind("links are slower by SIZE [s]", 0.05, 1.0, robots_only=False),
    "jitter": Kind("messages overtake each other, later by up to SIZE [s]", 0.05, 0.5, robots_only=False),
    "twice": Kind("receives and sends this share of its messages twice", 0.1, 1.0, robots_only=False),
    "again": Kind("what it receives and sends arrives again SIZE [s] later", 0.5, 8.0, robots_only=False),
    "late": Kind("links become slower by SIZE every second [s/s]", 0.1, 1.0, robots_only=False),
    "throttle": Kind("links carry SIZE [bytes/s]", 500.0, 5000.0, robots_only=False),
    "cut": Kind("has no links", robots_only=False),
    "deaf": Kind("receives nothing, while others receive it", robots_only=False),
    "mute": Kind("is received by no one, while it receives others", robots_only=False),
}
PROCESSES: Mapping[str, Kind] = {
    "kill": Kind("its process is killed, and started again at the end", robots_only=False),
    "reset": Kind("the same, and its disk is empty then", robots_only=False),
    "torn": Kind("its agent is killed while it writes its state and stops, and started again at the end"),
    "freeze": Kind("its process is suspended", robots_only=False),
    "slow": Kind("its process takes SIZE [s] for each step", 0.02, 0.3, robots_only=False),
    "unwatched": Kind("its watchdog is killed, and started again at the end"),
    "second": Kind("a second agent of the robot runs"),
    "mixed": Kind("its agent is restarted with another mission, until the end"),
}
MACHINES: Mapping[str, Kind] = {
    "clock": Kind("its system clock is SIZE [s] ahead", -100.0, 100.0, robots_only=False),
    "drift": Kind(
        "its system clock gains SIZE every second, and is set right at the end [s/s]",
        -0.05,
        0.05,
        robots_only=False,
    ),
    "full": Kind("its disk is full", robots_only=False),
}
BRIDGES: Mapping[str, Kind] = {
    "repeat": Kind("measurements of its place arrive again SIZE [s] later", 0.05, 0.5),
    "restart": Kind("its odometry counts from where it is as zero, also after the end"),
}
OPERATOR: Mapping[str, Kind] = {
    "hold": Kind("an operator holds all robots, and lets them run at the end", robots_only=False),
    "stop": Kind("an operator stops all robots, then releases them and lets them run", robots_only=False),
    "waver": Kind("an operator orders hold and run in turn, every 0.3 s", robots_only=False),
}
SENSORS: Mapping[str, Kind] = {
    "frozen": Kind("odometry and external pose repeat one place"),
    "tremble": Kind("the same, give or take SIZE [m]", 1e-6, 1e-3),
    "stutter": Kind("as frozen, in bursts of SIZE [s] with gaps as long", 0.1, 0.6),
    "stale": Kind("odometry and external pose are SIZE [s] late", 0.3, 4.0),
    "restamped": Kind("the same, with the stamps of when they are published", 0.3, 2.0),
    "backlog": Kind("they arrive later by SIZE every second [s/s]", 0.3, 1.0),
    "speeds": Kind("odometry reports SIZE times the true speeds", 0.0, 2.0),
    "blocked": Kind("its wheels do not turn"),
    "carried": Kind("it is moved at SIZE [m/s]", 0.05, 0.3),
    "relative_frozen": Kind("its sensor of neighbours repeats what it measured"),
    "scan_frozen": Kind("its range scanner repeats one scan"),
    "relative_late": Kind("its sensor of neighbours is SIZE [s] late", 0.3, 4.0),
    "scan_late": Kind("its range scanner is SIZE [s] late", 0.3, 4.0),
}
INSIDERS: Mapping[str, Kind] = {
    "forge": Kind("relays forged orders, with a valid certificate of its own; with --signed"),
    "replay": Kind("relays for half of the time true orders, and then these again; with --signed"),
}
KINDS: Mapping[str, Kind] = {
    **NETWORK,
    **PROCESSES,
    **MACHINES,
    **BRIDGES,
    **OPERATOR,
    **INSIDERS,
    **SENSORS,
}
DISTURBING = frozenset({*NETWORK, *PROCESSES})
"""Kinds of faults under which an operator's request may arrive after a newer one."""
STATE_LOSING = frozenset({"torn", "mixed"})
"""Kinds of faults after which a saved state is there that the restarted agent cannot use."""
FORM = "NAME:KIND[=SIZE]@START[+SECONDS]"


def parse(text: str, mission: Mission) -> Fault:
    """Parse a fault for `mission`. Raises ValueError, which names the legal values."""
    fault = sensed.parse(text, mission, KINDS_AND_SIZES, form=FORM)
    names = mission.followers if KINDS[fault.kind].robots_only else (*mission.names, *mission.standbys)
    if fault.robot not in names:
        raise ValueError(f"{text!r}: {fault.robot}: must be one of {', '.join(names)}")
    if fault.kind == "restart" and not _concerns(fault.kind, mission.robots[fault.robot]):
        legal = sensed.legal_robots(mission, lambda spec: _concerns(fault.kind, spec))
        raise ValueError(f"{text!r}: {fault.robot} has no odometry that counts from its start; {legal}")
    if begins_or_ends(fault) > MAX_HORIZON:
        raise ValueError(f"{text!r}: START + SECONDS must be at most {MAX_HORIZON:g} s")
    return fault


def begins_or_ends(fault: Fault) -> float:
    """Return when `fault` changes something for the last time: its end, or its start if it has no end [s]."""
    return fault.since + (fault.lasts if fault.lasts < math.inf else 0.0)


KINDS_AND_SIZES: Mapping[str, Size | None] = {
    **dict.fromkeys(KINDS),
    **sensed.SIZES,
    "loss": Size(0.5, 0.0, 1.0),
    "delay": Size(0.525, *DELAYS),
    "jitter": Size(0.275, *DELAYS),
    "twice": Size(0.55, 0.0, 1.0),
    "again": Size(4.25, *DELAYS),
    "late": Size(0.55, 0.0, 10.0, "s/s"),
    "throttle": Size(2750.0, 1.0, 100_000.0, "bytes/s"),
    "slow": Size(0.16, *DELAYS),
    "clock": Size(10.0, -100_000.0, 100_000.0, "s"),
    "drift": Size(0.01, -0.5, 0.5, "s/s"),
    "repeat": Size(0.275, *DELAYS),
}
"""Kinds of faults, and what their sizes may be; None for one without a size."""


def spelled(fault: Fault) -> str:
    """`fault` as it is typed."""
    legal = KINDS_AND_SIZES[fault.kind]
    size = "" if legal is None or fault.size == legal.usual else f"={fault.size:g}"
    lasts = f"+{fault.lasts:g}" if fault.lasts < math.inf else ""
    return f"{fault.robot}:{fault.kind}{size}@{fault.since:g}{lasts}"


def possible(kind: str, mission: Mission) -> bool:
    """Whether any robot of `mission` has the sensor that a fault of this kind is of."""
    return any(_concerns(kind, mission.robots[name]) for name in mission.followers)


def _concerns(kind: str, spec: RobotSpec) -> bool:
    """Whether a robot has the sensor that a fault of this kind is of."""
    if kind == "restart":
        return spec.odometry_frame == "start" and spec.localisation == "odometry"
    return sensed.concerns(kind, spec)


def draw(mission: Mission, kinds: Sequence[str], seed: int) -> list[Fault]:
    """Draw faults of `kinds` from `seed`, of those that are possible."""
    chance = random.Random(f"faults {seed}")
    kinds = [kind for kind in kinds if possible(kind, mission)]
    drawn = []
    for _ in range(chance.randint(1, MAX_DRAWN_FAULTS) if kinds else 0):
        kind = chance.choice(kinds)
        about = KINDS[kind]
        names = (*mission.names, *mission.standbys)
        if about.robots_only:
            names = tuple(name for name in mission.followers if _concerns(kind, mission.robots[name]))
        drawn.append(
            Fault(
                chance.choice(names),
                kind,
                float(f"{chance.uniform(about.lowest, about.highest):.3g}"),
                round(chance.uniform(FIRST_START, LAST_START), 1),
                round(chance.uniform(0.3, MAX_DRAWN_SECONDS), 1),
            )
        )
    return sorted(drawn, key=lambda one: one.since)


def inject(faults: Sequence[Fault], fleet: Fleet, operator: Operator) -> None:
    """Schedule the beginnings and ends of `faults`, except those of sensors, which the robots have."""
    for fault in faults:
        if fault.kind not in SENSORS:
            begin, end = _actions(fault, fleet, operator)
            fleet.engine.at(fault.since, begin)
            if fault.lasts < math.inf:
                fleet.engine.at(fault.since + fault.lasts, end)
    finite = [one for one in faults if one.lasts < math.inf]
    kinds = {one.kind for one in finite}
    last = max((one.since + one.lasts for one in finite), default=0.0)
    if kinds & STATE_LOSING or (kinds & OPERATOR.keys() and kinds & DISTURBING):
        fleet.engine.at(last + SECOND_RUN_TIME, operator.set_going)
    if "forge" in kinds:
        fleet.engine.at(last + SECOND_RUN_TIME, lambda: _answer_unread(fleet, operator))


def _answer_unread(fleet: Fleet, operator: Operator) -> None:
    """Order `run` if the leader waits for it, because it could not read the orders that robots relay."""
    if fleet.leading.plan.team_mode.unread:
        operator.order("run")


def _actions(
    fault: Fault, fleet: Fleet, operator: Operator
) -> tuple[Callable[[], object], Callable[[], object]]:
    """Return what begins a fault, and what ends it."""
    if fault.kind in NETWORK:
        return _of_network(fault, fleet)
    if fault.kind in PROCESSES:
        return _of_process(fault, fleet)
    if fault.kind in MACHINES:
        return _of_machine(fault, fleet)
    if fault.kind in INSIDERS:
        return lambda: _of_insider(fault, fleet), lambda: fleet.forge(fault.robot, forges=False)
    return _of_bridge(fault, fleet) if fault.kind in BRIDGES else _of_operator(fault, operator)


def _of_operator(fault: Fault, operator: Operator) -> tuple[Callable[[], object], Callable[[], object]]:
    if fault.kind == "waver":
        return lambda: operator.waver(fault.lasts), lambda: operator.order("run")
    return lambda: operator.order("stop" if fault.kind == "stop" else "hold"), operator.set_going


def _of_bridge(fault: Fault, fleet: Fleet) -> tuple[Callable[[], object], Callable[[], object]]:
    name, size, local = fault.robot, fault.size, fleet.local

    def repeat(delay: float) -> None:
        for topic in (ODOM, POSE):
            local.repeats[topic.key(name)] = delay  # 0: not any more

    def restart() -> None:
        local.changes[ODOM.key(name)] = Restarted().changed

    return {
        "repeat": (lambda: repeat(size), lambda: repeat(0.0)),
        "restart": (restart, lambda: None),
    }[fault.kind]


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


def _of_insider(fault: Fault, fleet: Fleet) -> None:
    """Begin to forge, or to record; then relay that from the middle of the fault on."""
    if fault.kind == "forge":
        fleet.forge(fault.robot, forges=True)
    elif fleet.keys is not None:
        lasts = fault.lasts if fault.lasts < math.inf else MAX_DRAWN_SECONDS
        fleet.engine.at(fault.since + 0.5 * lasts, fleet.record(fault.robot).play)


def _of_network(fault: Fault, fleet: Fleet) -> tuple[Callable[[], object], Callable[[], object]]:
    name, size, air = fault.robot, fault.size, fleet.air
    others = [other for other in fleet.machines if other != name]
    if fault.kind in {"cut", "deaf", "mute"}:
        pairs = [(other, name) for other in others if fault.kind != "mute"]
        pairs += [(name, other) for other in others if fault.kind != "deaf"]
        return lambda: air.cut(pairs), lambda: air.mend(pairs)
    weather = {
        "loss": Weather(loss=size),
        "delay": Weather(delay=size),
        "jitter": Weather(jitter=size),
        "twice": Weather(twice=size),
        "again": Weather(again=size),
        "late": Weather(growth=size, since=fault.since),
        "throttle": Weather(bandwidth=size),
    }[fault.kind]
    return lambda: air.disturb(name, weather), lambda: air.calm(name, weather)


def _of_process(fault: Fault, fleet: Fleet) -> tuple[Callable[[], object], Callable[[], object]]:
    name, kind = fault.robot, fault.kind

    def again(wipes: bool, mission: Mission | None = None) -> None:
        fleet.kill(name)
        if wipes:
            fleet.disks[name].files.clear()
        if mission is not None:
            fleet.start_agent(name, mission)
        else:
            fleet.start(name)

    def lag(seconds: float) -> None:
        fleet.process_of(name).lag = seconds

    def dismiss() -> None:
        fleet.rivals[name].kill()

    def unwatch() -> None:
        fleet.watchdogs[name].kill()

    other = fleet.mission.changed(duration=fleet.mission.duration + 1.0)
    return {
        "kill": (lambda: fleet.kill(name), lambda: again(wipes=False)),
        "reset": (lambda: fleet.kill(name), lambda: again(wipes=True)),
        "torn": (lambda: fleet.tear(name), lambda: again(wipes=False)),
        "freeze": (lambda: fleet.process_of(name).freeze(), lambda: fleet.process_of(name).thaw()),
        "slow": (lambda: lag(fault.size), lambda: lag(0.0)),
        "unwatched": (unwatch, lambda: fleet.start_watchdog(name)),
        "second": (lambda: fleet.start_rival(name), dismiss),
        "mixed": (lambda: again(wipes=False, mission=other), lambda: again(wipes=False)),
    }[kind]


def _of_machine(fault: Fault, fleet: Fleet) -> tuple[Callable[[], object], Callable[[], object]]:
    machine, disk, size = fleet.machines[fault.robot], fleet.disks[fault.robot], fault.size

    def drift(rate: float) -> None:
        machine.drift, machine.drift_since = rate, fleet.engine.now  # at rate 0 the clock is right again

    def step(seconds: float) -> None:
        machine.offset += seconds

    def fill(is_full: bool) -> None:
        disk.is_full = is_full

    return {
        "clock": (lambda: step(size), lambda: step(-size)),
        "drift": (lambda: drift(size), lambda: drift(0.0)),
        "full": (lambda: fill(is_full=True), lambda: fill(is_full=False)),
    }[fault.kind]
