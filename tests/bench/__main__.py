"""All benchmarks, one after the other, into docs/benchmarks.md and, for programs, docs/benchmarks.json.

python -m tests.bench [--quick]
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from tests.bench import bench_agent, bench_batch, bench_law, bench_monitor, bench_step
from tests.bench.figures import rounded

LIBRARIES = ("eclipse-zenoh", "numpy", "pydantic", "rosbags")
DOCS = Path(__file__).parents[2] / "docs"


class Part(NamedTuple):
    """One benchmark: a process of its own, so that none measures what another left behind."""

    title: str
    module: Any
    quick: tuple[str, ...] = ("--rounds", "1")

    @property
    def name(self) -> str:
        """What ``python -m`` calls it."""
        return str(self.module.__name__)


PARTS = (
    Part("The edge: one agent at 50 Hz", bench_agent, ("--rounds", "1", "--seconds", "5")),
    Part("One step of an agent", bench_step),
    Part(
        "The monitor: a hundred robots",
        bench_monitor,
        ("--rounds", "1", "--seconds", "5", "--step-seconds", "5"),
    ),
    Part("One step of the mathematics", bench_law),
    Part("The simulation", bench_batch, ("--quick",)),
)


def machine() -> str:
    """What the figures were measured on."""
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    load = f"shared with other work (load average {os.getloadavg()[1]:.1f} before)"
    python = f"{platform.system()}, Python {platform.python_version()}"
    return f"{os.cpu_count()} cores of {platform.machine()}, {load};\n{python}, {libraries}"


def document(where: str, found: dict[str, Any]) -> str:
    """docs/benchmarks.md."""
    sections = "\n".join(
        f"## {part.title}\n\n```sh\npython3 deploy/env.py python -m {part.name}\n```\n\n"
        f"{part.module.section(found[part.name])}"
        for part in PARTS
    )
    return f"""# Benchmarks

Written, with [the same figures for programs](benchmarks.json), by

```sh
python3 deploy/env.py python -m tests.bench
```

on {where}.

Figures are medians over rounds, in brackets the lowest and the highest round. On another machine the
milliseconds will differ; compare the ratios, whose two sides come from the same rounds.

{sections}"""


def main() -> None:
    """Run all benchmarks and write what they found."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="one short round, printed only; the figures mean little"
    )
    quick = parser.parse_args().quick
    where, found = machine(), {}
    for part in PARTS:
        print(f"{part.name} …", file=sys.stderr)
        command = [sys.executable, "-m", part.name, "--json", *(part.quick if quick else ())]
        found[part.name] = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    text = document(where, found)
    if quick:
        print(text)
        return
    (DOCS / "benchmarks.md").write_text(text)
    (DOCS / "benchmarks.json").write_text(json.dumps(rounded({"machine": where, **found}), indent=1) + "\n")


if __name__ == "__main__":
    main()
