"""An operator's stop to twenty robots: which acknowledge, how fast, and which stand."""

from __future__ import annotations

import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tests.campaigns.document import Found
from tests.campaigns.reliability import judge
from tests.campaigns.reliability.campaign import Options, summaries, tell
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.missions import crowd
from tests.campaigns.reliability.seen import window
from tests.campaigns.reliability.trial import Try
from tests.support.namespaces import until

TITLE = "Stop"
ROBOTS = 20
ACKNOWLEDGED = 0.2  # by everybody within that [s]
STANDING = 0.3  # more than an agent's period and its way to the wheels, among sixty processes [s]
MOMENT = 2.0  # a stop comes at any moment of so long [s]
ABOUT = f"""\
`formation order MISSION stop` from the desk to {ROBOTS} robots that drive, and a leader. *Acknowledged*:
until the last answer of those that can be reached (at most 200 ms). *Stands*: from the command's first
request until the last of them received zero velocity at its wheels, and nothing else from then on until the
release. An unreachable robot is unplugged (veth down) before the order: it has to be named, and no other."""

Case = Callable[[Fleet], tuple[list[str], Callable[[], object]]]
"""Makes it hard; what cannot answer, and how to make it easy again."""


def _unreachable(fleet: Fleet) -> tuple[list[str], Callable[[], object]]:
    name = random.choice(fleet.followers)
    computer = fleet.computer(f"agent {name}")
    computer.unplug()
    return [name], computer.plug


def _leaderless(fleet: Fleet) -> tuple[list[str], Callable[[], object]]:
    fleet.signal("leader", signal.SIGKILL)
    return ["leader"], lambda: fleet.start("leader").event("ready")


CASES: dict[str, tuple[str, Case]] = {
    "all": ("everybody is there", lambda _: ([], lambda: None)),
    "unreachable": ("one robot is unreachable", _unreachable),
    "leaderless": ("the leader has just been killed", _leaderless),
}


NAMES = list(CASES)


def run(options: Options) -> Found:
    tries: list[Try] = []
    chosen = [name for name in CASES if options.chosen(name)]
    with TemporaryDirectory(prefix="reliability-") as folder, _fleet(Path(folder)) as fleet:
        fleet.begin()
        for number in range(options.tries):
            for name in chosen:
                tries.append(stopped(fleet, name))
                words = "; ".join(tries[-1].wrong) or "as it should be"
                tell(f"{number + 1}/{options.tries} {name}: {tries[-1].figures} {words}")
                if tries[-1].wrong and options.keep is not None:
                    fleet.save(options.keep / f"stop-{name}-{number}")
    return summaries({name: CASES[name][0] for name in chosen}, tries)


def _fleet(folder: Path) -> Fleet:
    """Without what has no part in a stop: sixty-five processes are too many for a small machine."""
    return Fleet(crowd(ROBOTS), folder, without=("watchdog", "monitor"))


def stopped(fleet: Fleet, name: str) -> Try:
    one = Try(name)
    until(lambda: _drive(fleet), 60.0, "everybody drives")
    time.sleep(random.uniform(0.0, MOMENT))
    begin = time.monotonic()
    fleet.seen.forget(begin - 5.0)
    away, mend = CASES[name][1](fleet)
    code, report = fleet.order("stop")
    time.sleep(1.0)
    end = time.monotonic()
    fleet.seen.read_on()
    _judge(one, fleet, code, report, away, begin, end)
    mend()
    _release(fleet)
    motion = judge.motion(fleet.seen, begin)
    one.peak, one.jump, one.zeros = motion
    one.wrong += judge.faults(motion)
    return one


def _judge(
    one: Try, fleet: Fleet, code: int, report: dict[str, Any], away: list[str], begin: float, end: float
) -> None:
    if "missing" not in report:
        one.wrong.append(f"no report: {report}")
        return
    if set(report["missing"]) != set(away):
        one.wrong.append(f"missing {report['missing']} where {away} cannot be reached")
    if code != (1 if away else 0):
        one.wrong.append(f"exit code {code}")
    slowest = max((answer["ms"] for answer in report["acknowledged"]), default=0.0) / 1e3
    one.figures["acknowledged"] = slowest
    if slowest > ACKNOWLEDGED:
        one.wrong.append("somebody acknowledged after more than 200 ms")
    requested = max(begin, report["at"] - (time.time() - time.monotonic()))
    after = [judge.stood(fleet.seen.commands[name], requested, end) for name in fleet.followers]
    if never := after.count(None):
        one.wrong.append(f"{never} did not stand")
    one.figures["stands"] = stands = max((value for value in after if value is not None), default=0.0)
    if stands > ACKNOWLEDGED + STANDING:
        one.wrong.append("somebody stood late")


def _release(fleet: Fleet) -> None:
    for _ in range(10):
        code, report = fleet.order("release")
        if code == 0:
            break
    assert code == 0, f"release: {report}"
    code, report = fleet.order("run")
    assert code == 0, f"run: {report}"
    until(lambda: _drive(fleet), 60.0, "everybody drives again")


def _drive(fleet: Fleet) -> bool:
    """Whether everybody has been told to go for a while."""
    fleet.seen.read_on()
    now = time.monotonic()
    rows = [window(fleet.seen.commands[name], now - 1.0) for name in fleet.followers]
    return all(len(row) > 3 and not any(command.zero for command in row) for row in rows)
