"""What the edge costs: one agent at 50 Hz beside Zenoh without an agent, in the same run.

python -m tests.bench.bench_agent [--rounds N] [--seconds S] [--json]

Three processes take turns every 20 ms, each a third of a period after the other:

- agent: `python -m agent`, unmodified, with two neighbours and a monitor
- copy:  a bare Zenoh script with the agent's sessions, links, keys, rates and messages that computes nothing
- echo:  the same script with one key to hear and one to answer on

All three get the same odometry from this process and answer with a command. A latency is the time from `put`
of the odometry to the command in this process's receive callback; the next odometry waits until the last one
is answered, so every answer has its question. Each round starts all three anew. A round before replaces
the agent by one with stopwatches at its seams.
"""

from __future__ import annotations

import gc
import json
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from formation.topics import CMD_VEL, ODOM
from formation.transport.bus import Bus, BusConfig
from tests.bench.figures import flags, over_rounds, show, tail
from tests.bench.report_agent import section
from tests.bench.robot import Robots, Subject
from tests.bench.scene import ROBOTS, Scene

WARM_UP = 2.0
"""[s]"""
PARTS = (
    "odometry to the agent",
    "wake-up of its main thread",
    "decode odometry",
    "observer",
    "failsafe table",
    "law",
    "encode command and sign of life",
    "encode position and order",
    "rest of the step",
    "command to the robot",
)
"""Where the time between odometry and command goes, in order."""


@contextmanager
def surrounded(scene: Scene) -> Iterator[Bus]:
    """The neighbours and the monitor, alive; the bus of the robots, who are their own router."""
    others = subprocess.Popen(scene.surroundings(), stdout=subprocess.PIPE, stdin=subprocess.DEVNULL)
    try:
        assert others.stdout is not None
        if not others.stdout.readline():
            raise RuntimeError("the neighbours did not come up")
        with Bus(BusConfig(listen=(scene.robot,), mode="router")) as bus:
            for robot in ROBOTS.values():
                bus.advertise(ODOM, ODOM.key(robot))
                bus.subscribe(CMD_VEL.key(robot))
            yield bus
    finally:
        others.kill()
        others.communicate()


def one_round(
    bus: Bus, scene: Scene, subjects: Sequence[Subject], seconds: float
) -> dict[str, dict[str, dict[str, float]]]:
    """Start all subjects, measure them for so long and end them; figures by subject and kind."""
    bus.drain()  # last words of the round before
    robots = Robots(bus, subjects, scene.origin)
    try:
        for subject in subjects:
            subject.start()
            robots.drive(subject.has_moved)
        robots.drive_for(WARM_UP)
        for subject in subjects:
            subject.forget()
        before, start = [subject.cpu_time for subject in subjects], time.monotonic()
        robots.drive_for(seconds)
        after, elapsed = [subject.cpu_time for subject in subjects], time.monotonic() - start
        figures = {}
        for subject, busy in zip(subjects, np.subtract(after, before).tolist(), strict=True):
            figures[subject.name] = {
                "latency_ms": tail([(one.answered - one.sent) * 1e3 for one in subject.exchanges]),
                "answers": {"counted": float(len(subject.exchanges)), "lost": float(subject.lost)},
                "cost": {"cpu_percent": 100.0 * busy / elapsed, **subject.cost()},
                "start_s": {
                    "first command": subject.first - subject.started,
                    "first motion": subject.moving - subject.started,
                },
            }
        return figures
    finally:
        for subject in subjects:
            subject.end()


def with_ratios(figures: dict[str, dict[str, dict[str, float]]]) -> dict[str, Any]:
    """A round's figures with what the agent takes relative to the others in the same round."""

    def ratio(other: str, kind: str, name: str) -> float:
        return figures["agent"][kind][name] / figures[other][kind][name]

    return {
        **figures,
        "ratio": {
            "latency to echo": {
                name: ratio("echo", "latency_ms", name) for name in ("p50", "p90", "p99", "max")
            },
            "cost to copy": {name: ratio("copy", "cost", name) for name in figures["agent"]["cost"]},
        },
    }


def where_it_goes(profile: dict[str, Any], agent: Subject) -> dict[str, Any]:
    """The parts of each exchange of the profiled agent [µs]."""
    parts: dict[str, list[float]] = {part: [] for part in PARTS}
    steps = {step["arrived"]: step for step in profile["steps"] if "sent" in step}
    arrivals = np.array(sorted(steps))
    for sent, answered in agent.exchanges:
        index = int(np.searchsorted(arrivals, sent))
        if index == len(arrivals) or arrivals[index] > answered:
            continue
        step = steps[arrivals[index]]
        inside = {
            "decode odometry": step.get("decode", 0.0),
            "observer": step.get("observer", 0.0),
            "failsafe table": step.get("failsafe", 0.0),
            "law": step.get("law", 0.0),
            "encode command and sign of life": step.get("encode Twist", 0.0) + step.get("encode Number", 0.0),
            "encode position and order": step.get("encode Pose", 0.0) + step.get("encode Order", 0.0),
        }
        whole = {
            "odometry to the agent": step["arrived"] - sent,
            "wake-up of its main thread": step["begin"] - step["arrived"],
            **inside,
            "rest of the step": step["end"] - step["begin"] - sum(inside.values()),
            "command to the robot": answered - step["end"],
        }
        for part, took in whole.items():
            parts[part].append(took * 1e6)
    return {part: {"mean": float(np.mean(took)), **tail(took)} for part, took in parts.items()}


def profiled(bus: Bus, scene: Scene, seconds: float) -> dict[str, Any]:
    """A round with stopwatches inside the agent."""
    file = scene.folder / "profile.json"
    agent = Subject("agent", ROBOTS["agent"], scene.profiled_agent(file))
    echo = Subject("echo", ROBOTS["echo"], scene.echo())
    one_round(bus, scene, [agent, echo], seconds)
    profile = json.loads(file.read_text())
    return {
        "profile_us": where_it_goes(profile, agent),
        "longest_collection_us": max(profile["pauses"], default=0.0) * 1e6,
    }


def measure(rounds: int, seconds: float) -> dict[str, Any]:
    """All figures of the edge; medians over rounds with their lowest and highest."""
    with tempfile.TemporaryDirectory() as folder:
        scene = Scene(Path(folder))
        with surrounded(scene) as bus:
            gc.freeze()  # what stands by now needs no more collecting in the middle of a measurement
            profile = profiled(bus, scene, seconds)
            found = []
            for number in range(rounds):
                subjects = [Subject(who, ROBOTS[who], getattr(scene, who)()) for who in ROBOTS]
                # nobody is always the first to start
                subjects = subjects[number % 3 :] + subjects[: number % 3]
                found.append(with_ratios(one_round(bus, scene, subjects, seconds)))
    return {"rounds": rounds, "seconds": seconds, **over_rounds(found), **profile}


def main() -> None:
    """Print the figures."""
    parser = flags(__doc__)
    parser.add_argument("--seconds", type=float, default=30.0, help="of each round")
    arguments = parser.parse_args()
    show(measure(arguments.rounds, arguments.seconds), section, as_json=arguments.json)


if __name__ == "__main__":
    main()
