"""`python -m tests.campaigns.timings.leader_orders`: what the leader's velocity and place in its orders gain.

Prints the figures of docs/decisions/0059.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from formation.mission.model import Mission
from formation.simulation.body import PROFILES, Body
from formation.simulation.ensemble import Options
from formation.simulation.simulate import simulate
from tests.campaigns.bench import lower_bound
from tests.campaigns.bench.control_trials import circling_chain, drawn, six_robots, varied
from tests.support.fleet import Fleet

USES = ("none", "velocity", "place")
ALONE: dict[str, Any] = {"mode": "off", "lag": 0.0}
BODIES = {
    "ideal": Body(),
    "TurtleBots": PROFILES["turtlebot3_burger"]._replace(
        position_noise=0.0, heading_noise=0.0, drift=0.0, speed_step=0.0, turn_rate_step=0.0
    ),
}
"""Bodies of the chains, without noise, drift or steps."""
CORNER = ({"speed": 0.2, "heading_deg": 30, "duration": 10.0}, {"speed": 0.2, "heading_deg": 120})


def used(mission: Mission, use: str, **tables: Any) -> Mission:
    """The mission in which robots use so much of the leader's orders."""
    law = {**mission.law.model_dump(), "leader_orders": use}
    return varied(mission, law=law, collisions=ALONE, **tables)


def ramped(mission: Mission, ramp: float | None) -> Mission:
    """The mission with this ramp [s] of all robots; None leaves it as it is."""
    if ramp is None:
        return mission
    robots = mission.model_dump()["robots"]
    return varied(mission, robots={name: {**one, "ramp": ramp} for name, one in robots.items()})


def settling(use: str, ramp: float | None) -> str:
    mission, options = ramped(used(six_robots(), use), ramp), Options(avoid=False)
    result = simulate(mission, runs=1000, seed=1, horizon=40.0, starts="random", options=options)
    ratio = result.settling_time / lower_bound.by_distance(mission, drawn(mission, 1000, 1))
    return f"{np.nanmedian(ratio):.2f}x, 95 % {np.nanquantile(ratio, 0.95):.2f}x of the bound"


def fast_leader(use: str, ramp: float | None) -> str:
    """Behind a leader at 95 % of the top speed."""
    mission = ramped(used(six_robots(leader_speed=1.425), use), ramp)
    result = simulate(mission, runs=100, seed=1, horizon=200.0, starts="random", options=Options(avoid=False))
    share, times = result.converged.mean(), result.settling_time
    found = f"median {np.nanmedian(times):.1f} s, last {np.nanmax(times):.0f} s"
    return f"{100 * share:.0f} % settle behind a leader at 95 %, {found}"


def noise(use: str) -> str:
    """RMS of what noise leaves [cm], as stated in the mission."""
    found = []
    for size in (0.001, 0.002, 0.005, 0.01, 0.02):
        mission = varied(used(six_robots(), use), collisions={**ALONE, "noise": size})
        options = Options(avoid=False, body=Body(position_noise=size))
        result = simulate(mission, runs=100, seed=1, horizon=60.0, starts="random", options=options)
        late = result.error[2 * len(result.error) // 3 :]
        found.append(f"{100 * np.sqrt(np.mean(late**2)):.2f}")
    return f"{' '.join(found)} cm left by 1, 2, 5, 10, 20 mm of noise"


def chain(use: str, followers: int, body: str, delay: float) -> str:
    """A chain on a circle, after 100 s."""
    mission = used(circling_chain(followers), use)
    if body != "ideal":
        mission = varied(mission, collisions={**ALONE, "lag": 0.1})
    options = Options(delay=delay, body=BODIES[body], avoid=False)
    history = simulate(mission, horizon=120.0, options=options, keep=True).history
    assert history is not None
    points = history.points[history.time > 100.0, -2:]
    slots = mission.slots()
    error = np.abs(points[:, 0] - points[:, 1] - slots[-2] + slots[-1]).mean()
    return f"{100 * error:.3f} cm at hop {followers}, {body}, {delay:g} s late"


def corner(use: str, ramp: float | None) -> str:
    """Peak of the error of all edges on a square of 5 m."""
    mission = ramped(used(six_robots("square of 5 m"), use), ramp)
    result = simulate(mission, horizon=120.0, options=Options(avoid=False))
    peak = result.error[result.time > 15.0].max()
    return f"{100 * peak:.2f} cm at a square's corners"


def production(use: str) -> str:
    """Peak of the error of all edges at a corner, by production cores and messages up to 20 ms late."""
    law = {**six_robots().law.model_dump(), "leader_orders": use}
    fleet = Fleet(varied(six_robots(), law=law, route=CORNER), delay=(0.0, 0.02)).after(9.5)
    peak = max(one.error() for one in fleet.every(0.1, 6.5))
    return f"{100 * peak:.1f} cm at a corner, production cores"


def main() -> None:
    for use in USES:
        print(f"{use}:")
        for ramp, said in ((0.0, ""), (None, ", with the ramp")):
            for part in (settling, fast_leader, corner):
                print(f"  {part(use, ramp)}{said}", flush=True)
        for other in (noise, production):
            print(f"  {other(use)}", flush=True)
        for followers, body in ((12, "ideal"), (50, "TurtleBots")):
            for delay in (0.0, 0.1):
                print(f"  {chain(use, followers, body, delay)}", flush=True)


if __name__ == "__main__":
    main()
