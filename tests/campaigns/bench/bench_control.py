"""How well the laws control: same starts, same limits, same robots; beside the least that any law could take.

python -m tests.campaigns.bench.bench_control [--quick] [--json] [--figures FOLDER]

Nothing here depends on the machine or its load: from the same code come the same figures.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from tests.campaigns.bench import control_chains, control_parameters, control_parts
from tests.campaigns.bench.control_curves import draw
from tests.campaigns.bench.control_parts import Effort
from tests.campaigns.bench.report_control import section
from tests.campaigns.figures import rounded, show

QUICK = Effort(runs=24, many=100, every=4, chain=12, chain_time=60.0)
PARTS = {
    "laws": control_parts.laws,
    "convergence": control_parts.convergence,
    "routes": control_parts.on_routes,
    "conditions": control_parts.conditions,
    "saturation": control_parts.saturation,
    "chains": control_chains.chains,
    "parameters": control_parameters.search,
    "peer gains": control_parameters.peer_gains,
}


def measure(effort: Effort) -> Any:
    """All figures; what it takes goes to stderr."""
    found = {}
    for name, part in PARTS.items():
        began = time.perf_counter()
        found[name] = rounded(part(effort))
        print(f"{name}: {time.perf_counter() - began:.0f} s", file=sys.stderr)
    return found


def main() -> None:
    """Print the figures, and draw those that are curves."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="few starts, few points: only a hint")
    parser.add_argument("--json", action="store_true", help="figures for programs, not for people")
    parser.add_argument("--figures", type=Path, help="draw the curves into this folder")
    arguments = parser.parse_args()
    found = measure(QUICK if arguments.quick else Effort())
    if arguments.figures:
        draw(found, arguments.figures)
    show(found, section, as_json=arguments.json)


if __name__ == "__main__":
    main()
