"""Half an hour of faults on a fleet of twelve robots in bad air: nothing leaks, no robot is left standing."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from tests.campaigns.document import Found
from tests.campaigns.parts import table
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.campaign import Options, tell
from tests.campaigns.reliability.faults import KINDS
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.missions import crowd
from tests.campaigns.reliability.seen import window

TITLE = "Soak"
ROBOTS, STANDBYS = 12, 2
LOSS = 0.05
EVERY = 30.0  # [s]
SETTLED = 5.0 * 60.0  # from this age on a process may not grow [s]
GROWTH = 1.05
SAMPLED = 10.0  # memory is read so often [s]
LAST = 40.0  # at the end nothing is done for so long: what was hit has the time to come back [s]
ABOUT = f"""\
{ROBOTS} robots, {STANDBYS} standbys and a leader for half an hour; of all packets 5 % are lost, and every
30 s a random process but a robot's is killed and started again after 2 s, stopped (SIGSTOP) for 2 s, or its
computer unplugged for 2 s. *Grown* is a process's memory (PSS) at its end over that at its fifth minute,
for processes that became at least ten minutes old: at most 5 %. At the end `run` is ordered."""


class Reading(NamedTuple):
    """How much memory a process had."""

    age: float  # [s]
    pss: int  # [bytes]


NAMES = ("soak",)


def run(options: Options) -> Found:
    with (
        TemporaryDirectory(prefix="reliability-") as folder,
        Fleet(crowd(ROBOTS, STANDBYS), Path(folder), lossy=True) as fleet,
    ):
        fleet.lose(LOSS)
        fleet.begin()
        found = _soak(fleet, options.minutes * 60.0)
        if not found["well"] and options.keep is not None:
            fleet.save(options.keep / "soak")
        return found


def _soak(fleet: Fleet, lasts: float) -> Found:
    memory: dict[tuple[str, int], list[Reading]] = {}
    begin = time.monotonic()
    next_fault, next_look = begin + EVERY, begin
    worst, done = judge.Motion(0.0, 0.0, 0), Counter[str]()
    heals: list[tuple[float, Any]] = []
    while (now := time.monotonic()) < begin + lasts:
        if now >= next_look:
            next_look += SAMPLED
            _look(fleet, memory)
            worst = judge.Motion.worst((worst, judge.motion(fleet.seen, now - 2.0 * SAMPLED)))
            fleet.seen.forget(now - 3.0 * SAMPLED)
        for due in [one for one in heals if now >= one[0]]:
            heals.remove(due)
            due[1]()
        if now >= next_fault and now < begin + lasts - LAST:
            next_fault += EVERY
            words, heal = _hit(fleet)
            done[words.partition(" ")[0]] += 1
            heals.append((now + 2.0, heal))
            tell(f"{(now - begin) / 60.0:.1f} min, error {fleet.error(2.0)}: {words}")
        time.sleep(0.1)
    fleet.seen.read_on()
    _look(fleet, memory)
    end = fleet.seen.now
    rows = {name: window(fleet.seen.commands[name], end - 3.0) for name in fleet.followers}
    standing = [name for name, row in rows.items() if not row or any(one.zero for one in row)]
    return {**_verdict(memory, worst, standing, fleet.lost()), "faults": done, "minutes": lasts / 60.0}


def _hit(fleet: Fleet) -> tuple[str, Any]:
    """Do something to somebody; what, and how it is undone."""
    victim = random.choice([name for name in fleet.names if not name.startswith("robot")])
    kind = random.choice(list(KINDS))
    if kind == "unplug" and victim.startswith("watchdog"):
        kind = "kill"
    _, begin, end = KINDS[kind]
    begin(fleet, victim)
    return f"{kind} {victim}", lambda: end(fleet, victim)


def _look(fleet: Fleet, memory: dict[tuple[str, int], list[Reading]]) -> None:
    """Read everybody's memory."""
    fleet.seen.read_on()
    now = time.monotonic()
    for name, one in fleet.running.items():
        try:
            reading = Reading(now - _born(one.pid), _pss(one.pid))
        except (FileNotFoundError, ProcessLookupError):
            continue  # it has just been killed
        memory.setdefault((name, one.pid), []).append(reading)


def _verdict(
    memory: Mapping[tuple[str, int], Sequence[Reading]],
    motion: judge.Motion,
    standing: Sequence[str],
    ended: Sequence[str],
) -> Found:
    grown = {name: ratio for (name, _), rows in memory.items() if (ratio := growth(rows)) is not None}
    wrong = [
        *(f"{name} has grown by {100 * (one - 1):.1f} %" for name, one in grown.items() if one > GROWTH),
        *(f"{name} stands at the end" for name in standing),
        *(f"{name} ended" for name in ended),
    ]
    if motion.peak > judge.OVER:
        wrong.append(f"a command was {100 * motion.peak:.1f} % of a limit")
    return {"grown": grown, "wrong": wrong, "well": not wrong, "peak": motion.peak, "jump": motion.jump}


def growth(rows: Sequence[Reading]) -> float | None:
    """The last reading over the first one of a grown-up process; None if it was too young at its end."""
    old = [row for row in rows if row.age >= SETTLED]
    if not old or old[-1].age < 2.0 * SETTLED:
        return None
    return old[-1].pss / old[0].pss


def section(found: Found) -> str:
    parts: dict[str, list[float]] = {}
    for name, ratio in found["grown"].items():
        parts.setdefault(name.partition(" ")[0], []).append(ratio)
    rows = [
        f"{part} | {len(values)} | {100 * (sum(values) / len(values) - 1):+.1f} % | "
        f"{100 * (max(values) - 1):+.1f} %"
        for part, values in sorted(parts.items())
    ]
    faults = ", ".join(f"{times} × {kind}" for kind, times in found["faults"].items()) or "none"
    head = f"{found['minutes']:g} minutes; faults: {faults}. Largest command {100 * found['peak']:.0f} %.\n\n"
    tail = "".join(f"\n- {word}" for word in found["wrong"])
    return head + table("process | measured | grown, on average | at most", rows) + tail + "\n"


def _pss(pid: int) -> int:
    for line in Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii").splitlines():
        if line.startswith("Pss:"):
            return int(line.split()[1]) * 1024
    raise ProcessLookupError(pid)


def _born(pid: int) -> float:
    """When a process began [s, monotonic]."""
    ticks = int(Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[19])
    return ticks / 100.0
