"""What an agent says about itself: one diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from agent.avoiding import Avoiding
from agent.commander import Commander
from agent.failsafe import Decision, State
from agent.localisation import Localisation
from agent.motion_check import Disagreement, Kind
from agent.neighbourhood import Neighbourhood
from formation.order import FORGED_ORDER
from formation.ros2.messages import Diagnostics, Status
from formation.wire import Now

OK, WARNING = 0, 1

_MOTION = {
    Kind.FROZEN: "does not move though it is told to",
    Kind.TURN: "does not turn though it is told to",
    Kind.SPEEDS: "its speeds contradict its positions",
    Kind.CARRIED: "moved without a command",
    Kind.TURNED: "turned without a command",
}
"""What a robot does that does not move as it is told."""


class Surroundings(NamedTuple):
    """How an agent's process is connected, as its loop sees it; None where nobody knows."""

    connected: bool | None = None
    """Whether there is a link to the robot."""
    routed: bool | None = None
    """Whether anybody listens to the commands at its other end."""
    refused: Mapping[str, int] = MappingProxyType({})
    """How often others were refused by the bus, by kind."""
    rival: bool = False
    """Whether another agent's sign of life was received on the robot's side since the step before."""

    @property
    def link(self) -> str | None:
        """The link to the robot in words."""
        if self.connected is None:
            return None
        if not self.connected:
            return "not connected"
        if self.routed is False:
            return "no listener on cmd_vel: the bridge's route is lost"
        return "connected"


class Report(NamedTuple):
    """All that a status is made of."""

    robot: str
    law: str
    decision: Decision
    readonly: bool
    commander: Commander
    here: Localisation
    neighbours: Neighbourhood
    avoiding: Avoiding
    aside: bool
    """Whether the others are to go on without it."""
    motion: Disagreement | None
    """How the robot does not move as it is told."""
    gains: str
    """Of the law, where they are not the mission's."""
    surroundings: Surroundings
    dropped: Mapping[str, tuple[int, str]]
    mission: str = ""
    """Its fingerprint."""
    forgers: Mapping[str, str] = MappingProxyType({})
    """Neighbours that relayed forged orders of late, and what was wrong with them."""
    other_missions: Mapping[str, str] = MappingProxyType({})
    """Robots that run another one, with its tag."""


def status(report: Report, now: Now) -> Diagnostics:
    """The report as a message; a warning whenever the robot does not run or something is not believed."""
    around = report.neighbours
    streams = {report.here.source: report.here.stream} | {n: one.stream for n, one in around.each.items()}
    scanner = report.avoiding.scanner
    if scanner is not None:
        streams["range scan"] = scanner.stream
    unseen = None if scanner is None else scanner.doubt
    contested = around.contested(now)
    heard = {name: stream for name, stream in streams.items() if stream.arrived is not None}
    doubted = [name for name, stream in heard.items() if stream.fresh(now) and not stream.clock_agrees]
    state = f"readonly: would {report.decision.state}" if report.readonly else str(report.decision.state)
    command, link = report.commander.newest, report.surroundings.link
    values = {
        "state": state,
        "reason": report.decision.reason,
        "law": report.law,
        **({"gains": report.gains} if report.gains else {}),
        **({"mission": report.mission} if report.mission else {}),
        "speed": f"{command.speed:.4f}",
        "turn_rate": f"{command.turn_rate:.4f}",
        **({} if link is None else {"robot link": link}),
        **({"follows": ", ".join(around.guides)} if report.decision.state is State.RUN else {}),
        **({"aside": "the others go on without it"} if report.aside else {}),
        **({"stuck": _MOTION[report.motion.kind]} if report.motion is not None else {}),
        **report.avoiding.words(around),
        **({"range scan": unseen} if unseen else {}),
        "localisation": report.here.alignment,
        **_steps(report.commander),
        "jumps": str(report.here.jumps),
        "late": str(report.here.late),
        **{f"age {name}": f"{stream.silence(now):.3f}" for name, stream in heard.items()},
        **{f"clock {name}": f"stamped {streams[name].underway:.3f} s before it came" for name in doubted},
        **{f"second voice {name}": "two agents speak for it" for name in contested},
        **{f"{FORGED_ORDER}{name}": why for name, why in report.forgers.items()},
        **{f"other mission {name}": tag or "unknown" for name, tag in report.other_missions.items()},
        **{f"refused {kind}": str(count) for kind, count in report.surroundings.refused.items()},
        **{f"dropped {key}": f"{count}, last: {why}" for key, (count, why) in report.dropped.items()},
    }
    message = f"{state}: {report.decision.reason}"
    if doubted:
        message += f"; stamps of {', '.join(doubted)} not believed"
    if unseen and unseen not in message:
        message += f"; range scan {unseen}"
    if contested:
        message += f"; {', '.join(contested)} spoken for by a second voice"
    if report.forgers:
        message += f"; {', '.join(report.forgers)} relayed forged orders"
    if link not in {None, "connected"}:
        message += f"; robot link: {link}"
    if report.motion is not None and not report.decision.probes:
        message += f"; {_MOTION[report.motion.kind]}"
    at_work = report.decision.state is State.RUN and not report.readonly
    doubts = doubted or unseen or contested or report.motion is not None or report.forgers
    sound = not doubts and link in {None, "connected"}
    level = OK if at_work and sound else WARNING
    return Diagnostics(now.wall, (Status(f"{report.robot}: agent", level, message, report.robot, values),))


def _steps(commander: Commander) -> dict[str, str]:
    """What is done about a robot that cuts commands to steps."""
    if not any(commander.steps):
        return {}
    steps, left = commander.steps, commander.remainder
    return {
        "error feedback": f"steps of {steps.speed:g} m/s, {steps.turn_rate:g} rad/s; "
        f"carries {left.speed:+.4f} m/s, {left.turn_rate:+.4f} rad/s"
    }
