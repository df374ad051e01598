"""The leader is killed again and again; a standby takes its place, and never do two lead at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from formation.mission.file import load
from formation.mission.model import Mission
from formation.monitor.recording.reader import read
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.ros2.messages import Pose, decode
from formation.topics import POSITION
from tests.campaigns.document import Found
from tests.campaigns.plots import BLUE, INK, ORANGE, panels
from tests.campaigns.reliability import faults, judge
from tests.campaigns.reliability.campaign import Options, campaign, failures, table
from tests.campaigns.reliability.faults import rows
from tests.campaigns.reliability.fleet import Fleet
from tests.campaigns.reliability.seen import Led
from tests.campaigns.reliability.trial import Judgement, Row, Times, replaced


def recorded_leads(path: Path, mission: Mission) -> list[Led]:
    """Everything that was said as the leader, as the monitor heard it. Raises UnreadableError."""
    key, found = POSITION.key(mission.leader), []
    for recorded in read(path).messages():
        sample = recorded.sample
        if sample.key != key or sample.attachment is None:
            continue
        attachment, pose = (
            json_message.decode(PositionAttachment, sample.attachment),
            decode(Pose, sample.payload),
        )
        if attachment.order is not None:
            found.append(Led.of(recorded.wall, pose.position, attachment, attachment.order, mission))
    return found


TITLE = "Failover"
TAKEOVERS = "figures/reliability_takeover.svg"
NAMES = ("failover",)
BEFORE, AFTER = -0.5, 6.0  # of a takeover, what is shown [s]
ABOUT = """\
The process that leads is killed (kill -9) at a random moment, and started again after 2 s as a standby: the
next time another one dies. *In time* is from the kill to the first message of the one that leads then;
*error back after* counts from the kill, too. That at most one led at any moment is checked twice: by what
the witness received, and in the monitor's recording."""


def run(options: Options) -> Found:
    found, tries = campaign(options, faults.maker, (_row(),))
    found["curves"] = [one.curve for one in tries]
    return found


def section(found: Found) -> str:
    every = found["rows"].values()
    picture = f"![Formation error around {sum(row['tries'] for row in every)} takeovers]({TAKEOVERS})"
    return f"{table(every)}\n{picture}\n\n{failures(every)}"


def draw(found: Found, docs: Path) -> None:
    with panels(docs / TAKEOVERS, 1, (7.0, 3.0)) as (axes,):
        for curve in found["curves"]:
            shown = np.array([pair for pair in curve if BEFORE <= pair[0] <= AFTER])
            if len(shown):
                axes.plot(shown[:, 0], 1000.0 * shown[:, 1], color=BLUE, alpha=0.5, linewidth=1.0)
        axes.axhline(1000.0 * judge.NEAR, color=ORANGE, linewidth=1.0, linestyle="--")
        axes.axvline(0.0, color=INK, linewidth=1.0)
        axes.set_xlabel("since the leader was killed [s]")
        axes.set_ylabel("formation error [mm]")
        axes.set_xlim(BEFORE, AFTER)
        axes.set_ylim(bottom=0.0)


def _row() -> Row:
    kill = next(row for row in rows(load(faults.MISSION)) if row.name == "kill-leader")
    return kill._replace(name="failover", title="the leader killed", verdict=_alone)


def _alone(fleet: Fleet, victim: str, times: Times) -> Judgement:
    """Another takes its place, and no two lead at once in the recording."""
    found = replaced(fleet, victim, times)
    rivals = judge.rivals(recorded_leads(fleet.recording, fleet.mission))
    both = [f"in the recording {a} and {b} led at once" for a, b in rivals]
    return found._replace(wrong=[*found.wrong, *both])
