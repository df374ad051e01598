"""This machine's tools: chrony for the clock, systemd for the watchdog. None if a tool is missing."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from formation.deploy.doctor.facts import Chrony

WATCHDOG = "formation-watchdog.service"


def chrony() -> Chrony | None:
    """Return the result of ``chronyc tracking``; None without chrony."""
    output = _output_of(["chronyc", "-c", "-n", "tracking"])
    return None if output is None else read_tracking(output)


def read_tracking(line: str) -> Chrony | None:
    """Parse the line of ``chronyc -c tracking``: field 5 is the offset [s], the last one the leap status."""
    fields = line.strip().split(",")
    try:
        offset = float(fields[4])
    except (IndexError, ValueError):
        return None
    return Chrony(offset, fields[-1] != "Not synchronised")


def watchdog_unit() -> str | None:
    """Return the state of the watchdog's systemd unit, such as active or failed; None without a unit."""
    output = _output_of(["systemctl", "show", "-p", "LoadState", "-p", "ActiveState", WATCHDOG])
    facts = dict(line.partition("=")[::2] for line in (output or "").splitlines())
    return facts.get("ActiveState") if facts.get("LoadState") == "loaded" else None


def _output_of(words: Sequence[str]) -> str | None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
