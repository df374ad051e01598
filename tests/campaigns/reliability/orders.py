"""Orders that are lost, late or repeated, second agents, mixed missions and wrong clocks, in real processes.

`tests.campaigns.timings` tries the same at a thousand random timings of each in virtual time.
"""

from __future__ import annotations

import random
import time
import tomllib
from pathlib import Path
from signal import SIGCONT, SIGKILL, SIGSTOP
from threading import Timer
from typing import Any

import tomlkit

from formation.transport.wiring import endpoints
from tests.campaigns.document import Found
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.campaign import Options, campaign, summaries
from tests.campaigns.reliability.faults import RESTART, local_port
from tests.campaigns.reliability.fleet import DESK, Fleet, module
from tests.campaigns.reliability.missions import STRAIGHT
from tests.campaigns.reliability.seen import window
from tests.campaigns.reliability.trial import PATIENCE, STANDS, Judgement, Row, Times, holders
from tests.support.namespaces import until

TITLE = "Orders"
MISSION = "patrol"
DAY, HOUR = 86_400.0, 3600.0  # [s]
UNLINKED = 3.0  # after so long without its robot an agent has noticed that [s]
ABOUT = f"""\
Operator's orders at random moments to a fleet that drives straight on, while links are cut, processes are
frozen or started anew, agents are doubled, missions are mixed or a leader's clock is wrong. *Stands* is from
the acknowledgement of a stop or a hold until the last robot that acknowledged it received zero velocity at
its wheels (within {STANDS:g} s). It must receive nothing else before `run` is ordered: no stop and no hold
is lost, no release starts motion. Never two processes may lead at once, and in the end all must form
again."""


def _cut_leader(fleet: Fleet, leader: str) -> None:
    """Order a hold within 1.2 s of the moment at which the leader is cut off; then a standby leads."""
    computer, later = fleet.computer(leader), random.uniform(-1.2, 1.2)
    cut = Timer(max(later, 0.0), computer.unplug)
    cut.start()
    time.sleep(max(-later, 0.0))
    _give(fleet, "hold")
    cut.join()
    fleet.wrong += [
        f"{name} did not acknowledge the hold" for name in fleet.followers if name not in fleet.obeying
    ]
    time.sleep(random.uniform(2.0, 4.0))
    if random.random() < 0.3:
        _restart(fleet, f"agent {random.choice(fleet.followers)}")
    computer.plug()
    time.sleep(2.0)


def _lose_orders(fleet: Fleet, leader: str) -> None:
    """Order stops, holds and releases, each of which may miss one process; some agents are started anew."""
    orders = random.choice((["hold", "stop", "release", "release"], ["stop", "release", "release"]))
    parties = [leader, *(f"agent {name}" for name in fleet.followers)]
    for do in (*orders, *random.choices(("stop", "hold", "release", "restart"), k=2)):
        if do == "restart":
            _restart(fleet, random.choice(parties[1:]))
            continue
        away = [fleet.computer(random.choice(parties))] if random.random() < 0.6 else []
        for computer in away:
            computer.unplug()
        _give(fleet, do)
        for computer in away:
            computer.plug()
        time.sleep(random.choice((0.0, 0.3, 1.5)))
    if not fleet.obeying:
        fleet.wrong.append("no robot acknowledged anything")


def _freeze_agent(fleet: Fleet, _leader: str) -> None:
    """An agent is frozen while a run and a stop are ordered; it may receive both when it goes on."""
    name = random.choice(fleet.followers)
    _give(fleet, "hold")
    time.sleep(random.uniform(0.3, 1.0))
    fleet.signal(f"agent {name}", SIGSTOP)
    fleet.obeying.clear()  # the others are to run now
    fleet.order("run")
    _give(fleet, "stop")
    fleet.signal(f"agent {name}", SIGCONT)
    fleet.obeying[name] = time.monotonic()
    time.sleep(random.uniform(1.0, 3.0))


def _cut_robot(fleet: Fleet, _leader: str) -> None:
    """An agent that cannot reach its robot, or must not, is named as not stopped."""
    name = random.choice(fleet.followers)
    agent, readonly = f"agent {name}", random.random() < 0.3
    if readonly:
        fleet.end(agent)
        fleet.start(agent, "--readonly").event("ready")
    else:
        _cut_robot_of(fleet, name)
    time.sleep(UNLINKED + random.uniform(0.0, 2.0))
    code, report = _give(fleet, "stop")
    unstopped = {*report["unreached"], *report["missing"], *(one["robot"] for one in report["refused"])}
    if code != 1 or unstopped != {name}:
        fleet.wrong.append(f"not stopped: {sorted(unstopped)}, exit code {code}, where {name} cannot be")
    if readonly:
        fleet.end(agent)
        fleet.start(agent).event("ready")
    else:
        fleet.computer(agent).nft("delete table inet cut")
    _insist(fleet, "stop")
    time.sleep(1.0)


def _cut_robot_of(fleet: Fleet, name: str) -> None:
    """Cut the link between an agent and its robot; that of the watchdog, which brakes it, stays."""
    computer, pid = fleet.computer(f"watchdog {name}"), fleet.running[f"watchdog {name}"].pid
    until(lambda: local_port(computer, pid), what=f"the watchdog of {name} has a link with its robot")
    hook, kept = "type filter hook input priority 0;", local_port(computer, pid)
    computer.nft(f"add table inet cut; add chain inet cut in {{ {hook} }}")
    for robot, other in (("dport", "sport"), ("sport", "dport")):
        computer.nft(f"add rule inet cut in iifname lo tcp {robot} 7447 tcp {other} != {kept} drop")


def _double_agent(fleet: Fleet, leader: str) -> None:
    """Part the fleet so that only a robot whose two agents both vote gives each part a majority.

    The second agent still reaches its robot, or it would have no position to vote with.
    """
    names = random.sample(fleet.followers, len(fleet.followers))
    doubled, half = names[0], len(names) // 2
    words = ["--readonly"] if random.random() < 0.5 else []
    words += ["--robot-connect", f"tcp/{fleet.aside(doubled)}:7447"]
    words += [word for end in endpoints(fleet.mission).agents.values() for word in ("-e", end)]
    second = fleet.field.computers[DESK].start(
        *module("formation.agent"), fleet.path, "--robot", doubled, *words
    )
    second.event("ready")
    time.sleep(random.uniform(0.0, 4.0))
    fleet.part([doubled, *names[1 : half + 1], fleet.computer(leader).name])
    time.sleep(random.uniform(4.0, 7.0))
    fleet.heal()
    time.sleep(random.uniform(0.0, 2.0))
    second.stop()


def _mix_missions(fleet: Fleet, victim: str) -> None:
    """Start an agent with a mission in which its slot is another one."""
    name = victim.rpartition(" ")[2]
    data = tomllib.loads(fleet.path.read_text(encoding="utf-8"))
    x, y = data["shapes"][fleet.mission.first_shape][name]
    data["shapes"][fleet.mission.first_shape][name] = [x - 1.0, y]
    other = fleet.folder / "other.toml"
    other.write_text(tomlkit.dumps(data), encoding="utf-8")
    fleet.end(victim)
    fleet.start(victim, mission=other).event("ready")
    time.sleep(random.uniform(2.0, 4.0))


def _wrong_clock(fleet: Fleet, leader: str) -> None:
    """Start the leader with a wrong clock, some agents as well, and set it right after a while."""
    off = random.choice((DAY + random.uniform(1.0, HOUR), -HOUR))
    fleet.signal(leader, SIGKILL)
    fleet.set_clock(fleet.mission.leader, off, driver=False)
    fleet.start(leader).event("ready")
    for name in random.sample(fleet.followers, random.randint(0, 2)):
        _restart(fleet, f"agent {name}")
    time.sleep(random.uniform(0.0, 3.0))
    fleet.set_clock(fleet.mission.leader, 0.0, driver=False)


def _give(fleet: Fleet, do: str) -> tuple[int, dict[str, Any]]:
    """Give an order; note which robots acknowledge a stop or a hold, and when."""
    code, report = fleet.order(do)
    assert "at" in report, f"{do}: {report}"
    if do in {"stop", "hold"}:
        at = report["at"] - (time.time() - time.monotonic())
        for one in report["acknowledged"]:
            if one["robot"] in fleet.followers:
                fleet.obeying.setdefault(one["robot"], at + one["ms"] / 1e3)
    return code, report


def _resume(fleet: Fleet, _victim: str) -> None:
    """Release all, see that nothing moves, and let all run."""
    _insist(fleet, "release")
    time.sleep(1.5)
    fleet.freed = time.monotonic()
    _insist(fleet, "run")


def _insist(fleet: Fleet, do: str) -> None:
    """Give an order until all have acknowledged it."""
    deadline = time.monotonic() + PATIENCE
    while (given := _give(fleet, do))[0] != 0:
        assert time.monotonic() < deadline, f"{do} was not acknowledged by all: {given}"


def _restart(fleet: Fleet, process: str) -> None:
    fleet.signal(process, SIGKILL)
    time.sleep(RESTART)
    fleet.start(process).event("ready")


def _obeyed(fleet: Fleet, _victim: str, _times: Times) -> Judgement:
    """Each robot stands from its acknowledgement until all may run."""
    wrong, slowest = fleet.wrong, 0.0
    for name, since in fleet.obeying.items():
        after = judge.stood(fleet.seen.commands[name], since, fleet.freed)
        if after is None or after > STANDS:
            wrong.append(f"{name} had acknowledged and stood after {after} s")
        slowest = max(slowest, after or 0.0)
    fleet.wrong, fleet.obeying = [], {}
    return Judgement({"stands": slowest}, wrong)


def _held(fleet: Fleet, victim: str, times: Times) -> Judgement:
    """The robot of another mission stands, and those that have no other neighbour."""
    name = victim.rpartition(" ")[2]
    wrong = [
        f"{one} moved beside a robot with another mission"
        for one in (name, *holders(fleet.mission, (name,)))
        if any(not command.zero for command in window(fleet.seen.commands[one], times.end - 1.5, times.end))
    ]
    return Judgement({}, wrong)


def _leading(fleet: Fleet) -> str:
    return fleet.leading


def _any_agent(fleet: Fleet) -> str:
    return f"agent {random.choice(fleet.followers)}"


ROWS = (
    Row("hold", "a hold while the leader is cut off", _cut_leader, _resume, _leading, _obeyed, 0.0),
    Row("release", "orders that miss one process each", _lose_orders, _resume, _leading, _obeyed, 0.0),
    Row(
        "late",
        "an agent frozen while run and stop are ordered",
        _freeze_agent,
        _resume,
        _leading,
        _obeyed,
        0.0,
    ),
    Row("nowhere", "a stop to an agent without its robot", _cut_robot, _resume, _leading, _obeyed, 0.0),
    Row("double", "a second agent for a robot, in two parts", _double_agent, victim=_leading, lasts=0.0),
    Row("mixed", "an agent with another mission", _mix_missions, _restart, _any_agent, _held, 0.0),
)
ALONE = (
    Row("clock", "a leader's clock a day ahead or an hour slow", _wrong_clock, victim=_leading, lasts=0.0),
)
NAMES = [row.name for row in (*ROWS, *ALONE)]


def run(options: Options) -> Found:
    tries = []
    for maker, rows in ((_fleet, ROWS), (_without_standbys, ALONE)):
        if any(options.chosen(row.name) for row in rows):
            tries += campaign(options, maker, rows)[1]
    return summaries({row.name: row.title for row in (*ROWS, *ALONE) if options.chosen(row.name)}, tries)


def _fleet(folder: Path) -> Fleet:
    return Fleet(MISSION, folder, STRAIGHT)


def _without_standbys(folder: Path) -> Fleet:
    return Fleet(MISSION, folder, {**STRAIGHT, "standbys": None})
