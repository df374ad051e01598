"""The fault matrix."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from formation.mission.file import load
from tests.campaigns.document import Found
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.part import Options, campaign
from tests.campaigns.reliability.placed import STRAIGHT
from tests.campaigns.reliability.rows import rows
from tests.campaigns.reliability.table import failures, table

TITLE = "Faults"
MISSION = "patrol"
ABOUT = """\
One thing at a time is done to a fleet that drives straight on in formation, at a random moment, and undone
after 2 s (where nothing else is said): a killed process is started again, as systemd does. *In time* is when
the robot of a dead, hung or unplugged agent was told to stand, by its watchdog or by the agent itself (within
0.3 s); when a standby led in the dead leader's place; or how much of a killed monitor's recording is
missing."""


def run(options: Options) -> Found:
    """Try them all."""
    found, _ = campaign(options, maker, rows(load(MISSION)))
    return found


def maker(folder: Path) -> Fleet:
    """The fleet that it happens to."""
    return Fleet(MISSION, folder, STRAIGHT)


def names() -> Sequence[str]:
    """Its rows."""
    return [row.name for row in rows(load(MISSION))]


def seconds(options: Options) -> float:
    """What it takes."""
    return 170.0 * options.tries / options.fields


def section(found: Found) -> str:
    """For people."""
    every = found["rows"].values()
    return f"{table(every)}\n{failures(every)}"
