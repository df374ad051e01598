"""What an agent knows now: as facts for the failsafe table, and as its status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, NamedTuple

from formation.agent.safety.failsafe import Facts
from formation.protocol.reasons import Reason
from formation.protocol.status import AgentState, AgentStatus, CollisionMode, RobotLink
from formation.wire import Now

if TYPE_CHECKING:
    from formation.agent.core import Agent

RIVAL_HOLD_TIME = 1.0
"""The robot holds for this long after another agent's sign of life [s], and for 3 periods at least."""

REFUSED_TIME = 1.0
"""How long after its arrival a refused position or scan is named instead of a silence [s], and 3 periods at
least."""


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


def facts(agent: Agent, now: Now) -> Facts:
    """Return the inputs of the failsafe table."""
    here, around, state = agent.here, agent.neighbours, agent.state
    scanner, surroundings = agent.avoiding.scanner, state.surroundings
    return Facts(
        latched=agent.latch.mode,
        why=agent.latch.state.why,
        source=here.source,
        connected=surroundings.connected,
        routed=None if agent.readonly else surroundings.routed,
        silence=here.stream.silence(now),
        limit=here.stream.limit,
        refused=agent.inbox.own_refusal(now.mono - max(REFUSED_TIME, here.stream.limit)),
        jumped=here.state.jumped,
        doubt=here.doubt,
        outside=state.outside,
        beyond=() if around.guides else around.beyond,
        too_old=here.state.trust.held,
        age=here.stream.age_on_arrival,
        age_limit=here.state.age_limit,
        follows=here.state.follows,
        order=agent.orders.newest,
        beat_silence=now.mono - state.orders.rose,
        neighbours={} if around.guides else around.silences(now),
        followed=len(around.guides),
        not_followed=() if around.guides else around.not_followed(now),
        unanswered={one.name: late for one in agent.others if (late := one.unanswered(now)) is not None},
        relative_doubt=_relative_doubt(agent, now),
        sight_doubt=None if agent.perception is None else agent.perception.doubt(now),
        unsigned=agent.orders.unsigned(now),
        leaderless=not around.guides and around.leaderless(now),
        motion=state.motion.doubt,
        probe_blocked=state.probe.blocked,
        frozen=state.wakefulness.pause,
        missing=_missing(agent),
        finite=state.finite,
        rival=now.mono - state.rival <= max(RIVAL_HOLD_TIME, here.stream.limit),
        mission=agent.mission.tag,
        other_missions=_other_missions(agent, now),
        scan_silence=0.0 if scanner is None else scanner.silence(now),
        scan_limit=math.inf if scanner is None else scanner.stream.limit,
        scan_refused=""
        if scanner is None
        else agent.inbox.scan_refusal(now.mono - max(REFUSED_TIME, scanner.stream.limit)),
        scan_doubt=scanner.doubt if scanner is not None and scanner.required else None,
    )


def _missing(agent: Agent) -> tuple[str, ...]:
    """What has not been received since this process was frozen."""
    state = agent.state
    came = {
        agent.here.source: state.here.follows,
        "orders of the leader": state.orders.rose > state.wakefulness.woke,
    }
    return tuple(what for what, here in came.items() if not here)


def _relative_doubt(agent: Agent, now: Now) -> Reason | None:
    """Why a sensor of neighbours is not believed, unless the robot can do without what it shows."""
    around, avoids = agent.neighbours, agent.avoiding.avoids
    doubts = around.doubts(now)
    return next((why for name, why in doubts.items() if not around.guides or name in avoids), None)


def _other_missions(agent: Agent, now: Now) -> dict[str, str]:
    return {one.name: tag for one in agent.others if (tag := one.other_mission(now)) is not None}


def status(agent: Agent, now: Now) -> AgentStatus:
    """Return the status."""
    here, around, avoiding, tuning = agent.here, agent.neighbours, agent.avoiding, agent.tuning
    command, motion, decision = agent.command, agent.state.motion.doubt, agent.decision
    surroundings, scanner = agent.state.surroundings, avoiding.scanner
    streams = {here.source: here.stream} | {name: one.stream for name, one in around.each.items()}
    if scanner is not None:
        streams["scan"] = scanner.stream
    received = {name: stream for name, stream in streams.items() if stream.state.arrived is not None}
    filtering, sight = avoiding.has_obstacles, agent.perception
    steps, left = agent.commander.steps, agent.commander.state.remainder
    quantised = any(steps)
    return AgentStatus(
        robot=agent.robot,
        state=decision.state,
        reason=decision.reason,
        readonly=agent.readonly,
        law=agent.controller.name,
        mission=agent.mission.fingerprint,
        speed=round(command.speed, 4),
        turn_rate=round(command.turn_rate, 4),
        k_p=tuning.state.k_p if tuning.tuned else None,
        k_i=tuning.state.k_i if tuning.tuned else None,
        link=surroundings.link,
        follows=around.guides if decision.state is AgentState.RUN else (),
        unavailable=agent.state.availability.published,
        motion=None if motion is None else motion.kind,
        collisions=CollisionMode(avoiding.mode) if filtering else None,
        avoiding=filtering and avoiding.state.acting,
        avoids=avoiding.avoids,
        avoids_never_received=avoiding.never_received(around),
        avoided=avoiding.state.avoided,
        deadlocks=avoiding.state.avoidance.deadlocks,
        zone=None if scanner is None else scanner.state.zone,
        scan_fault=None if scanner is None else scanner.doubt,
        relative_fault=next(iter(around.doubts(now).values()), None),
        sight=None if sight is None else sight.sight(now),
        sight_age={} if sight is None else sight.ages(now),
        sight_deviation={} if sight is None else sight.deviations(now),
        sight_lost=() if sight is None else sight.lost(now),
        sight_correction=None if sight is None else here.correction,
        localisation=here.alignment,
        realigned=here.state.source.realigned,
        realigned_after=here.state.source.realigned_after,
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
        forged=agent.orders.forgers(now),
        other_mission=_other_missions(agent, now),
        refused=surroundings.refused,
        dropped=dict(agent.dropped),
        dropped_last=agent.inbox.state.last_dropped,
    )
