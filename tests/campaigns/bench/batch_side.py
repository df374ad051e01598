"""One side of `bench_batch` in a process of its own: how fast it steps robots, and the memory that it takes.

python -m tests.campaigns.bench.batch_side SIDE PLAN

A side imports what it needs when it is called: a peer's Python has nothing of this project.
"""

from __future__ import annotations

import json
import math
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

ABREAST = 10
"""Robots in a row of one formation."""
CIRCLES = {"irsim": (0.2, 0.1), "robotarium": (0.1, 1.0)}
"""Speed and turn rate of the peers' robots, constant [m/s; rad/s]."""
APART = 2.0
"""Between ir-sim's robots [m]."""
FEWEST = 2
"""Steps of the first, untimed run."""


class Taken(NamedTuple):
    """What a run came to."""

    robot_steps: int
    seconds: float
    """Wall time of the steps, without what was made ready before."""


Run = Callable[[int], Taken]
"""Takes all robots so many steps further."""


class RefusedError(Exception):
    """This side does not take so many robots; the message is in its own words."""


def measured(name: str, prepare: Callable[[dict[str, Any]], Run]) -> None:
    """Print as JSON how fast the robots of the plan on the command line are stepped.

    The plan, which `prepare` takes, has at least `robots`, `step` [s] and either `seconds` to measure for or
    the number of `steps`.
    """
    plan = json.loads(sys.argv[2])
    began = time.perf_counter()
    try:
        run = prepare(plan)
    except RefusedError as refusal:
        print(json.dumps({"name": name, "refused": str(refusal)}))
        return
    ready = time.perf_counter()
    run(FEWEST)
    first = time.perf_counter()
    steps, taken = (plan["steps"], run(plan["steps"])) if "steps" in plan else timed(run, plan["seconds"])
    found = {
        "name": name,
        "robot_steps_per_s": taken.robot_steps / taken.seconds,
        "steps": float(steps),
        "ready_s": ready - began,
        "first_s": first - ready,
        "peak_mib": peak_mib(),
    }
    print(json.dumps(found))


def timed(run: Run, seconds: float) -> tuple[int, Taken]:
    """A run that takes about `seconds` or longer: its steps, and what it came to."""
    steps = FEWEST
    while (taken := run(steps)).seconds < 0.8 * seconds:
        steps = math.ceil(steps * min(50.0, seconds / taken.seconds))
    return steps, taken


def peak_mib() -> float:
    """The most memory that this process has had resident [MiB]."""
    # getrusage would count what the parent had before this program was executed
    status = Path("/proc/self/status").read_text(encoding="ascii")
    kibibytes = next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:"))
    return int(kibibytes) / 1024.0


def formation() -> None:
    """This project's side.

    The plan says whether its robots are many runs of the shipped six robots or one formation, and may name a
    law, whether robots avoid each other, and a delay and a loss of every link. Only followers are counted: a
    leader merely is where its route says.
    """
    from importlib.metadata import version

    import numpy as np

    from formation.mission.file import load
    from formation.simulation.ensemble import Options
    from formation.simulation.simulate import simulate
    from tests.unit.formation import scenarios

    def prepare(plan: dict[str, Any]) -> Run:
        robots, step = plan["robots"], plan["step"]
        if plan.get("one_formation"):  # a metre apart, each measuring the two before it
            place = np.arange(robots)
            slots = (-(place // ABREAST) - 1j * (place % ABREAST)).astype(np.complex128)
            neighbours = [tuple(j for j in (i - 2, i - 1) if j >= 0) for i in range(robots)]
            mission, runs = scenarios.build(slots, neighbours, simulation={"spread": 0.4}), 1
        else:
            mission = load("six_robots")
            runs = max(1, robots // len(mission.followers))
        options = Options(
            delay=plan.get("delay", 0.0), loss=plan.get("loss", 0.0), avoid=plan.get("avoid", True)
        )
        law = plan.get("law")

        def run(steps: int) -> Taken:
            found = simulate(
                mission, runs=runs, law=law, options=options, horizon=step * steps, step=step, starts="random"
            )
            return Taken(found.robot_steps, found.wall_time)

        return run

    measured(f"formation {version('zenoh-formation')}", prepare)


def irsim() -> None:
    """ir-sim's side: differential-drive robots that drive circles, as told at every step.

    Of what ir-sim offers this costs least: no figure, no sensor, no robot in another's way, and no behaviour,
    for with one every robot lists all others at each step. The commands are one row for all robots from the
    first on, because robots that are named are looked for.
    """
    import irsim
    import numpy as np

    def prepare(plan: dict[str, Any]) -> Run:
        robots, side = plan["robots"], math.ceil(math.sqrt(plan["robots"]))
        group = {
            "number": robots,
            "distribution": {"name": "manual"},
            "kinematics": {"name": "diff"},
            "shape": {"name": "circle", "radius": 0.1},
            "vel_max": [1.5, 1.5],
            "vel_min": [-1.5, -1.5],
            "state": [[APART * (i % side), APART * (i // side), 0.0] for i in range(robots)],
        }
        size = {"width": APART * side, "height": APART * side}
        world = {**size, "step_time": plan["step"], "collision_mode": "unobstructed"}
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "world.yaml"
            text = json.dumps({"world": world, "robot": [group]})  # which is YAML as well
            file.write_text(text, encoding="utf-8")
            environment = irsim.make(str(file), headless=True, log_level="WARNING")
        speed, turn_rate = CIRCLES["irsim"]
        commands = [np.array([[speed], [turn_rate]])] * robots

        def run(steps: int) -> Taken:
            last = environment.robot_list[-1]
            before, began = last.state.copy(), time.perf_counter()
            for _ in range(steps):
                environment.step(commands, action_id=0)
            seconds = time.perf_counter() - began
            if (last.state == before).all():
                raise RuntimeError("the robots stand still")
            return Taken(steps * robots, seconds)

        return run

    measured(f"ir-sim {irsim.__version__}", prepare)


def robotarium() -> None:
    """The Robotarium simulator's side: robots that drive circles, as told at every step.

    The plan names the checkout to import it from. The same command for ever costs least: no law, no barrier
    certificate. What the simulator does at each step cannot be left out: it looks for collisions and for
    robots outside its arena, and draws noise for encoders, accelerometers, gyroscopes, magnetometers and
    headings.
    """
    import numpy as np

    def prepare(plan: dict[str, Any]) -> Run:
        sys.path.insert(0, plan["checkout"])
        from rps.robotarium import Robotarium  # its place is known only now

        if plan["step"] != Robotarium.TIME_STEP:
            raise RefusedError(f"its step is {Robotarium.TIME_STEP} s")
        robots = plan["robots"]
        places = [(x, y, 0.0) for y in np.linspace(-0.8, 0.8, 5) for x in np.linspace(-1.4, 1.4, 10)]
        try:
            arena = Robotarium(
                number_of_robots=robots,
                show_figure=False,
                sim_in_real_time=False,
                skip_initialization=True,
                initial_conditions=np.array(places[:robots]).T,
            )
        except (AssertionError, ValueError) as error:
            raise RefusedError(str(error)) from None
        speed, turn_rate = CIRCLES["robotarium"]
        everybody, command = np.arange(robots), np.tile([[speed], [turn_rate]], robots)

        def run(steps: int) -> Taken:
            began = time.perf_counter()
            for _ in range(steps):
                arena.get_poses()  # it insists on being asked
                arena.set_velocities(everybody, command)
                arena.step()
            return Taken(steps * robots, time.perf_counter() - began)

        return run

    setup = (Path(json.loads(sys.argv[2])["checkout"]) / "setup.py").read_text(encoding="utf-8")
    found = re.search(r"^VERSION\s*=\s*'([^']+)'", setup, re.MULTILINE)
    measured(f"Robotarium {found[1] if found else 'of unknown version'}", prepare)


if __name__ == "__main__":
    {"formation": formation, "irsim": irsim, "robotarium": robotarium}[sys.argv[1]]()
