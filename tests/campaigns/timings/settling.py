"""`python -m tests.campaigns.timings.settling`: settling times with ramp and filter, and with slower ramps.

Prints the figures of docs/decisions/0057 for the law as it is; those of rejected variants were measured so
as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation.mission.file import load
from formation.mission.model import Mission
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.campaigns.bench import lower_bound
from tests.campaigns.bench.control_trials import drawn, six_robots
from tests.campaigns.timings.leader_orders import used
from tests.support.missions import with_robots
from tests.unit.formation import scenarios

ALONE = Options(avoid=False)
MISSIONS = 800
"""Random missions."""


def beside_the_bound(name: str, mission: Mission, options: Options) -> str:
    """Settling times of six robots from 1,000 random starts, beside the bound by distance."""
    result = simulate(mission, runs=1000, seed=1, horizon=60.0, starts="random", options=options)
    times = np.where(result.converged, result.settling_time, np.inf)
    ratio = times / lower_bound.by_distance(mission, drawn(mission, 1000, 1))
    return f"{name}: {np.median(ratio):.2f}x, 95 % {np.quantile(ratio, 0.95):.2f}x, {np.median(times):.2f} s"


def with_ramp(name: str, ramp: float) -> str:
    """Settling times of a shipped mission with this ramp [s], from 40 random starts."""
    result = simulate(with_robots(name, ramp=ramp), runs=40, horizon=60.0, step=0.05)
    times = np.where(result.converged, result.settling_time, np.inf)
    return f"{name}, ramp {ramp} s: {result.converged.sum()} of 40 settle, median {np.median(times):.1f} s"


def random_mission(seed: int) -> Mission:
    """A mission without cycles of 3 to 8 robots with random limits, ramp, rate and leader."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 9))
    neighbours = scenarios.random_neighbours(rng, count)
    slots = -0.8 * np.arange(count) + 1j * rng.uniform(-1.0, 1.0, count)
    robot: dict[str, Any] = {
        "control_point_offset": float(rng.choice([0.05, 0.1, 0.2, 0.4])),
        "max_speed": float(rng.choice([0.22, 0.5, 1.0, 2.0])),
        "max_turn_rate": float(rng.choice([0.5, 1.0, 2.0, 3.0])),
        "ramp": float(rng.choice([0.0, 0.25, 0.5, 1.0, 2.0])),
        "rate": float(rng.choice([10.0, 20.0, 50.0])),
    }
    speed = float(rng.choice([0.0, 0.1, 0.3, 0.5, 0.7, 0.85])) * robot["max_speed"]
    lag = float(rng.choice([0.0, 0.05, 0.1, 0.2]))
    return scenarios.build(
        slots - slots[0], neighbours, {"speed": speed, "heading_deg": 0.0},
        law={"leader_orders": "none"}, robot=robot, collisions={"mode": "off", "lag": lag},
    )  # fmt: skip


def settles(seed: int) -> bool:
    """Whether a random mission settles from ten random starts within 120 s."""
    mission = random_mission(seed)
    period = 1.0 / mission.robot.rate
    result = simulate(mission, runs=10, seed=seed, horizon=120.0, step=period, spread=1.0, options=ALONE)
    return bool(result.converged.all())


def main() -> None:
    """Print them."""
    six = six_robots()
    print(beside_the_bound("with ramp", used(six, "none"), ALONE))
    print(beside_the_bound("as shipped", six, Options()))
    print(beside_the_bound('as shipped, avoid = "all"', with_robots("six_robots", avoid="all"), Options()))
    for name in ("patrol", "six_robots"):
        for ramp in (load(name).robot.ramp, 0.5, 1.0):
            print(with_ramp(name, ramp), flush=True)
    failed = sum(not settles(seed) for seed in range(MISSIONS))
    print(f"{failed} of {MISSIONS} random missions have a start that does not settle")


if __name__ == "__main__":
    main()
