"""The fault matrix: what is done to which process, how it is undone, and what must follow.

What must come of every one of them stands in `tests.campaigns.reliability.trial`: no command over a limit, no
jump, one leader, the error back.
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from signal import SIGCONT, SIGKILL, SIGSTOP

from formation.mission.file import load
from formation.mission.model import Mission
from tests.campaigns.document import Found
from tests.campaigns.reliability import trial
from tests.campaigns.reliability.campaign import Options, campaign
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.missions import STRAIGHT
from tests.campaigns.reliability.trial import Act, Row
from tests.support.namespaces import Computer, until
from tests.support.needs import path_of

RESTART = 0.5  # what systemd waits before it starts again what died (`RestartSec`) [s]


def rows(mission: Mission) -> tuple[Row, ...]:
    first, middle, leaf = roles(mission)
    victims: dict[str, tuple[str, Callable[[Fleet], str]]] = {
        "leader": ("the leader", lambda fleet: fleet.leading),
        "first-hop": ("a first-hop follower's agent", lambda _: f"agent {first}"),
        "mid": ("a mid-chain follower's agent", lambda _: f"agent {middle}"),
        "leaf": ("a leaf's agent", lambda _: f"agent {leaf}"),
        "monitor": ("the monitor", lambda _: "monitor"),
        "watchdog": ("a watchdog", lambda _: f"watchdog {middle}"),
    }
    return (
        *(_row(kind, role, *victims[role]) for role in victims for kind in KINDS),
        Row("partition", "the graph parted in two for 5 s", _part, lambda fleet, _: fleet.heal(), lasts=5.0),
        *(_clock(f"agent {middle}", off) for off in (10.0, -10.0, 3600.0, -3600.0)),
        _clock(f"agent {middle}", 10.0, driver=False),
        Row("rolling", "every process restarted in turn", _roll, lasts=0.0),
    )


def roles(mission: Mission) -> tuple[str, str, str]:
    """A follower that measures the leader, one in the middle of a chain, one that no robot measures."""
    measured = {other for name in mission.followers for other in mission.robots[name].neighbours}
    first = next(name for name in mission.followers if mission.leader in mission.robots[name].neighbours)
    inner = [name for name in mission.followers if mission.leader not in mission.robots[name].neighbours]
    middle = next(name for name in inner if name in measured)
    leaf = next(name for name in reversed(mission.followers) if name not in measured)
    return first, middle, leaf


KINDS: Mapping[str, tuple[str, Act, Act]] = {
    "kill": ("kill -9 {}", lambda fleet, one: fleet.signal(one, SIGKILL), Fleet.start),
    "pause": (
        "SIGSTOP {}, SIGCONT",
        lambda fleet, one: fleet.signal(one, SIGSTOP),
        lambda fleet, one: fleet.signal(one, SIGCONT),
    ),
    "unplug": (
        "veth of {} down, up",
        lambda fleet, one: fleet.computer(one).unplug(),
        lambda fleet, one: fleet.computer(one).plug(),
    ),
}
"""What is done to a process, in words, how, and how it is undone."""


def _row(kind: str, role: str, title: str, victim: Callable[[Fleet], str]) -> Row:
    words, begin, end = KINDS[kind]
    if (kind, role) == ("unplug", "watchdog"):  # it has one link, within its computer
        begin, end, words = _mute, _unmute, "{}'s link to the robot cut, mended"
    special = {
        ("kill", "monitor"): trial.recorded,
        ("unplug", "watchdog"): trial.anything,  # what it sent meanwhile arrives when it is mended: zero
    }
    usual = {"leader": trial.replaced, "monitor": trial.unmoved, "watchdog": trial.unmoved}
    judged = special.get((kind, role), usual.get(role, trial.stands))
    heals = role == "leader"  # a standby does it
    return Row(f"{kind}-{role}", words.format(title), begin, end, victim, judged, heals=heals)


def _mute(fleet: Fleet, process: str) -> None:
    computer, pid = fleet.computer(process), fleet.running[process].pid
    until(lambda: local_port(computer, pid), what="the watchdog has a link with its robot")
    port = local_port(computer, pid)
    hook = "type filter hook input priority 0;"
    computer.nft(f"add table inet mute; add chain inet mute in {{ {hook} }}")
    for side in ("sport", "dport"):
        computer.nft(f"add rule inet mute in tcp {side} {port} drop")


def local_port(computer: Computer, pid: int) -> str | None:
    """Of a process's link with the robot."""
    done = computer.run(path_of("ss"), "-tnpH", "state", "established", "dport = :7447")
    lines = [line for line in done.stdout.splitlines() if f"pid={pid}," in line]
    return lines[0].split()[2].rpartition(":")[2] if lines else None


def _unmute(fleet: Fleet, process: str) -> None:
    fleet.computer(process).nft("delete table inet mute")


def _part(fleet: Fleet, _victim: str) -> None:
    """Half of the followers, and whoever leads, on one side; the other half on the other."""
    followers = list(fleet.followers)
    random.shuffle(followers)
    fleet.part(followers[: len(followers) // 2])


def _clock(process: str, off: float, *, driver: bool = True) -> Row:
    sign = "+" if off > 0 else "−"
    size = f"{abs(off):g} s" if abs(off) < 100.0 else f"{abs(off) / 3600.0:g} h"

    def step(by: float) -> Act:
        return lambda fleet, victim: fleet.set_clock(victim.rpartition(" ")[2], by, driver=driver)

    of = "one robot" if driver else "one agent, not of its robot's driver,"
    title = f"system clock of {of} stepped {sign}{size}, and back"
    return Row(f"clock{'' if driver else '-agent'}{off:+g}", title, step(off), step(0.0), lambda _: process)


def _roll(fleet: Fleet, _victim: str) -> None:
    """As after an update: each is asked to end, started again, and waited for before the next one."""
    for process in fleet.names:
        if process.startswith("robot"):
            continue  # it stands for the hardware
        fleet.end(process)
        time.sleep(RESTART)
        fleet.start(process).event("ready")


TITLE = "Faults"
MISSION = "patrol"
ABOUT = """\
One thing at a time is done to a fleet that drives straight on in formation, at a random moment, and undone
after 2 s (where nothing else is said): a killed process is started again, as systemd does. *In time* is when
the robot of a dead, hung or unplugged agent received zero velocity, from its watchdog or from the agent
itself (within 0.3 s); when a standby led in the dead leader's place; or how much of a killed monitor's
recording is missing."""


NAMES = [row.name for row in rows(load(MISSION))]


def run(options: Options) -> Found:
    found, _ = campaign(options, maker, rows(load(MISSION)))
    return found


def maker(folder: Path) -> Fleet:
    return Fleet(MISSION, folder, STRAIGHT)
