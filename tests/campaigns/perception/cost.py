"""`python -m tests.campaigns.perception.cost`: processor time of an agent for a scan, among posts [µs].

Medians, and the times that 99 % stay below.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median, quantiles
from typing import Any

from formation.agent.perception.perception import Perception
from tests.campaigns.perception.drift import Case, fleet_of

SECONDS = 30.0
CASE = Case("straight", world="mujoco", posts=0.6)


def timed(call: Callable[..., Any], times: list[float]) -> Callable[..., Any]:
    """Return `call`; the processor time of each one is added to `times` [s]."""

    def measured(*arguments: Any) -> Any:
        began = time.thread_time()
        result = call(*arguments)
        times.append(time.thread_time() - began)
        return result

    return measured


def main() -> None:
    """Print how long segments of a scan, and association and filter, take."""
    times: dict[str, list[float]] = {"take_scan": [], "_use": []}
    for name, found in times.items():
        setattr(Perception, name, timed(getattr(Perception, name), found))
    fleet_of(CASE, 0).engine.run(SECONDS)
    for about, found in zip(("segments", "association and filter"), times.values(), strict=True):
        each = [1e6 * one for one in found]
        most = quantiles(each, n=100)[-1]
        print(f"{about}: {median(each):.0f}, 99 % below {most:.0f} ({len(each)} scans)")


if __name__ == "__main__":
    main()
