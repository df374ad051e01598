"""What an agent says about itself: one diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from agent.failsafe import Decision, State
from agent.stream import Stream
from formation.messages import Diagnostics, Status
from formation.unicycle import Command
from formation.wire import Now

OK, WARNING = 0, 1


class Report(NamedTuple):
    """All that a status is made of."""

    robot: str
    law: str
    decision: Decision
    command: Command
    neighbours: Mapping[str, Stream]
    odometry: Stream
    late: int
    dropped: Mapping[str, tuple[int, str]]


def status(report: Report, now: Now) -> Diagnostics:
    """The report as a message; a warning whenever the robot does not run or stamps are not believed."""
    streams = {"odometry": report.odometry, **report.neighbours}
    heard = {name: stream for name, stream in streams.items() if stream.arrived is not None}
    doubted = [name for name, stream in heard.items() if stream.fresh(now) and not stream.clock_agrees]
    values = {
        "state": str(report.decision.state),
        "reason": report.decision.reason,
        "law": report.law,
        "speed": f"{report.command.speed:.4f}",
        "turn_rate": f"{report.command.turn_rate:.4f}",
        "late": str(report.late),
        **{f"age {name}": f"{stream.silence(now):.3f}" for name, stream in heard.items()},
        **{f"clock {name}": f"stamped {streams[name].underway:.3f} s before it came" for name in doubted},
        **{f"dropped {key}": f"{count}, last: {why}" for key, (count, why) in report.dropped.items()},
    }
    level = OK if report.decision.state is State.RUN and not doubted else WARNING
    message = f"{report.decision.state}: {report.decision.reason}"
    if doubted:
        message += f"; stamps of {', '.join(doubted)} not believed"
    return Diagnostics(now.wall, (Status(f"{report.robot}: agent", level, message, report.robot, values),))
