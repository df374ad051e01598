"""How long it takes to get going: an agent until its first command, a mission until all robots move.

python -m tests.campaigns.bench.bench_startup [--quick] [--rounds N] [--json]

One after the other in each round: bare interpreters, so that it is seen what of an agent's start is its own;
the agent, a bare Zenoh copy of it and a bare echo (those of `bench_agent`, beside neighbours and a robot that
are there already); then `formation run`, from the command to the last robot's first command to move, as its
recording has it. Files are in the page cache and modules compiled, as at every start of a machine's day
but the first.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from formation.mission.file import load
from formation.monitor.recording.reader import read
from formation.ros2.messages import Twist, decode
from formation.topics import CMD_VEL, ODOM
from tests.campaigns.bench import edge
from tests.campaigns.bench.bench_agent import surrounded
from tests.campaigns.bench.processes import ready_to_start
from tests.campaigns.bench.scene import ROBOTS, Robots, Scene
from tests.campaigns.figures import command, filled, markdown, over_rounds, progress, span, verdict

INTERPRETERS = {
    "python, nothing else": "pass",
    "python, import zenoh": "import zenoh",
    "python, import numpy": "import numpy",
    "python, all that an agent imports": "import formation.agent.__main__",
}
RUNS_FOR = 3.0
"""How long a mission is run [s]."""
BAR = 0.5
"""From the start of an agent to its first command [s]."""


def measure(rounds: int, missions: Sequence[str] = ("six_robots", "two_chains")) -> dict[str, Any]:
    """All figures [s]; medians over rounds with their lowest and highest."""
    ready_to_start()
    found = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in range(rounds):
            progress(f"round {number + 1} of {rounds} …")
            found.append(
                {
                    "interpreters": {what: interpreter(code) for what, code in INTERPRETERS.items()},
                    "processes": processes(folder, number),
                    "missions": {mission: run(mission, folder) for mission in missions},
                }
            )
    return {"rounds": rounds, **over_rounds(found)}


def interpreter(code: str) -> float:
    """How long a process takes that does only this [s]."""
    start = time.monotonic()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.monotonic() - start


def processes(folder: Path, number: int) -> dict[str, dict[str, float]]:
    """Agent, copy and echo, one after the other, until they answer odometry [s]."""
    scene = Scene(folder, edge.RATE)
    took = {}
    with surrounded(scene) as bus:
        for subject in scene.subjects(number):
            try:
                subject.start()
                Robots(bus, [subject], scene.origin, scene.rate).drive(subject.has_moved)
            finally:
                subject.end()
            took[subject.name] = {
                "first command": subject.first - subject.started,
                "first command that moves": subject.moving - subject.started,
            }
    return {who: took[who] for who in ROBOTS}


def run(mission: str, folder: Path) -> dict[str, float]:
    """`formation run`, until its robots speak, and until each is on its way [s]."""
    recording = folder / f"{time.monotonic_ns()}.mcap"
    options = ["--duration", str(RUNS_FOR), "--json", "--page", "127.0.0.1:0", "--record", str(recording)]
    start = time.time()
    done = subprocess.run(
        [sys.executable, "-m", "formation.deploy", "run", mission, *options],
        check=False, capture_output=True, text=True,
    )  # fmt: skip
    if done.returncode not in {0, 1}:  # 1: it need not converge in so short a time
        raise RuntimeError(f"formation run {mission} ended with {done.returncode}: {done.stderr[-2000:]}")
    processes = len(json.loads(done.stdout.splitlines()[-1])["processes"])
    followers = load(mission).followers
    spoke, moved = (dict.fromkeys(map(topic.key, followers), 0.0) for topic in (ODOM, CMD_VEL))
    for message in read(recording).messages():
        sample, since = message.sample, message.wall - start
        if sample.key in spoke:
            spoke[sample.key] = spoke[sample.key] or since
        elif sample.key in moved and not moved[sample.key] and decode(Twist, sample.payload).speed != 0.0:
            moved[sample.key] = since
    if not all(moved.values()):
        raise RuntimeError(f"formation run {mission}: not all robots came on their way in {RUNS_FOR:g} s")
    return {
        "every robot speaks": max(spoke.values()),
        "first robot on its way": min(moved.values()),
        "all robots on their way": max(moved.values()),
        "processes": float(processes),
    }


def section(found: dict[str, Any]) -> str:
    """The figures in Markdown."""
    agent = found["processes"]["agent"]["first command"]
    single = [
        *((what, span(took, 2), "") for what, took in found["interpreters"].items()),
        *(
            (f"{who}, answering odometry", *(span(one[what], 2) for what in one))
            for who, one in found["processes"].items()
        ),
    ]
    whole = [
        (
            f"`formation run {mission}`, {one['processes']['median']:.0f} processes",
            *(span(took, 2) for what, took in one.items() if what != "processes"),
        )
        for mission, one in found["missions"].items()
    ]
    what = [name for name in next(iter(found["missions"].values())) if name != "processes"]
    how = filled(
        f"""One process after the other, {found["rounds"]} rounds, files in the page cache. From its start
        to an agent's first command {span(agent, 2, " s")}, wanted ≤ {BAR:g} s:
        **{verdict(agent["median"] <= BAR)}**."""
    )
    header = ("from the start of the process [s]", "until it ends, or its first command", "first that moves")
    return f"""{how}
{markdown(header, single)}
A whole mission on this machine, from the command to the messages in its recording [s]:

{markdown(("", *what), whole)}"""


if __name__ == "__main__":
    command(__doc__, measure, section, missions=["six_robots"])
