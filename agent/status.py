"""The status of an agent, made from its parts."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from formation.agent.collision_filter import Avoiding
from formation.agent.following.gains import Tuning
from formation.agent.following.neighbours import Neighbourhood
from formation.agent.inbox import Inbox
from formation.agent.pose.estimator import Localisation
from formation.agent.pose.motion_check import Disagreement
from formation.agent.safety.commander import Commander
from formation.agent.safety.failsafe import Decision
from formation.protocol.status import AgentState, AgentStatus, CollisionMode, RobotLink
from formation.wire import Now


class Surroundings(NamedTuple):
    """How an agent's process is connected, as its loop sees it; None where that is unknown."""

    connected: bool | None = None
    """Whether there is a link to the robot."""
    routed: bool | None = None
    """Whether anything at its other end receives the commands."""
    refused: Mapping[str, int] = MappingProxyType({})
    """Number of times that the bus refused others, by kind."""
    rival: bool = False
    """Whether another agent's sign of life was received on the robot's side since the step before."""

    @property
    def link(self) -> RobotLink:
        """The link to the robot."""
        if self.connected is None:
            return RobotLink.UNKNOWN
        if not self.connected:
            return RobotLink.NOT_CONNECTED
        return RobotLink.NO_LISTENER if self.routed is False else RobotLink.CONNECTED


class Report(NamedTuple):
    """All data of a status."""

    robot: str
    law: str
    decision: Decision
    readonly: bool
    commander: Commander
    here: Localisation
    neighbours: Neighbourhood
    avoiding: Avoiding
    unavailable: bool
    """Whether dependants should prefer another neighbour."""
    motion: Disagreement | None
    """How the robot does not move as it is commanded."""
    tuning: Tuning
    surroundings: Surroundings
    inbox: Inbox
    mission: str = ""
    """Its fingerprint."""
    forgers: Mapping[str, str] = MappingProxyType({})
    """Neighbours that relayed forged orders lately, and what was wrong with the newest."""
    other_missions: Mapping[str, str] = MappingProxyType({})
    """Robots that run another mission, with its tag."""


def status(report: Report, now: Now) -> AgentStatus:
    """Return the status of these parts."""
    around, here, avoiding, command = (
        report.neighbours,
        report.here,
        report.avoiding,
        report.commander.state.newest,
    )
    scanner, state = avoiding.scanner, report.decision.state
    streams = {here.source: here.stream} | {name: one.stream for name, one in around.each.items()}
    if scanner is not None:
        streams["scan"] = scanner.stream
    received = {name: stream for name, stream in streams.items() if stream.state.arrived is not None}
    filtering = avoiding.has_obstacles
    steps, left = report.commander.steps, report.commander.state.remainder
    quantised, tuned = any(steps), report.tuning.tuned
    return AgentStatus(
        robot=report.robot,
        state=state,
        reason=report.decision.reason,
        readonly=report.readonly,
        law=report.law,
        mission=report.mission,
        speed=round(command.speed, 4),
        turn_rate=round(command.turn_rate, 4),
        k_p=report.tuning.state.k_p if tuned else None,
        k_i=report.tuning.state.k_i if tuned else None,
        link=report.surroundings.link,
        follows=around.guides if state is AgentState.RUN else (),
        unavailable=report.unavailable,
        motion=None if report.motion is None else report.motion.kind,
        collisions=CollisionMode(avoiding.mode) if filtering else None,
        avoiding=filtering and avoiding.state.acting,
        avoids=avoiding.avoids,
        avoids_never_received=avoiding.never_received(around),
        avoided=avoiding.state.avoided,
        deadlocks=avoiding.state.avoidance.deadlocks,
        zone=None if scanner is None else scanner.state.zone,
        scan_fault=None if scanner is None else scanner.doubt,
        relative_fault=next(iter(around.doubts(now).values()), None),
        localisation=here.alignment,
        realigned=here.realigned,
        realigned_after=here.realigned_after,
        jumps=here.state.jumps,
        late=here.state.late,
        speed_step=steps.speed if quantised else None,
        turn_rate_step=steps.turn_rate if quantised else None,
        speed_remainder=round(left.speed, 4) if quantised else None,
        turn_rate_remainder=round(left.turn_rate, 4) if quantised else None,
        age={name: round(stream.silence(now), 3) for name, stream in received.items()},
        clock={
            name: round(stream.state.delay, 3)
            for name, stream in received.items()
            if stream.fresh(now) and not stream.clock_agrees
        },
        contested=tuple(around.contested(now)),
        forged=report.forgers,
        other_mission=report.other_missions,
        refused=report.surroundings.refused,
        dropped={key: count for key, (count, _) in report.inbox.unused.items()},
        dropped_last={key: why for key, (_, why) in report.inbox.unused.items()},
    )
