"""What this machine's own tools say: chrony of the clock, systemd of the guard. None where there is none."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence

from deploy.doctor.facts import Chrony

GUARD = "formation-guard.service"


def chrony() -> Chrony | None:
    """What ``chronyc tracking`` says; None without chrony."""
    said = _said(["chronyc", "-c", "-n", "tracking"])
    return None if said is None else read_tracking(said)


def read_tracking(line: str) -> Chrony | None:
    """The line of ``chronyc -c tracking``: field 5 is the offset [s], the last one the leap status."""
    fields = line.strip().split(",")
    try:
        offset = float(fields[4])
    except (IndexError, ValueError):
        return None
    return Chrony(offset, fields[-1] != "Not synchronised")


def guard_unit() -> str | None:
    """What systemd says of the guard's unit, such as active or failed; None where it knows no such unit."""
    said = _said(["systemctl", "show", "-p", "LoadState", "-p", "ActiveState", GUARD])
    facts = dict(line.partition("=")[::2] for line in (said or "").splitlines())
    return facts.get("ActiveState") if facts.get("LoadState") == "loaded" else None


def _said(words: Sequence[str]) -> str | None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=5.0, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
