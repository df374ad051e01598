"""The agent: one follower's controller, without a clock, a socket or a log.

`Agent.step(now, inbox) -> outbox` processes the received messages and returns those to send, commands first.
Each measurement of its own position, from odometry or an external camera, triggers a step: newest neighbours,
law, command, at once. A step without one only checks for silence.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import chain

from formation.agent.collision_filter import Avoiding, AvoidingState
from formation.agent.following.attachment import Answers, AnswersState, Availability
from formation.agent.following.gains import Tuning, TuningState
from formation.agent.following.neighbour import Neighbour
from formation.agent.following.neighbours import Neighbourhood, NeighbourhoodState
from formation.agent.following.orders import Orders, OrdersState
from formation.agent.following.slots import Slots, SlotsState
from formation.agent.inbox import Inbox, InboxState, Wakefulness
from formation.agent.perception.perception import Perception, PerceptionState
from formation.agent.pose.estimator import Localisation, LocalisationState
from formation.agent.pose.motion_check import MotionCheck, MotionCheckState
from formation.agent.pose.probe import Probe, ProbeState
from formation.agent.safety import failsafe
from formation.agent.safety.commander import Commander, CommanderState
from formation.agent.safety.failsafe import Decision
from formation.agent.safety.latch import HALTED, Latch, LatchState, is_own
from formation.agent.status import Surroundings, facts, status
from formation.control.controller import error
from formation.control.laws import law_of, why_unusable
from formation.control.pipeline import (
    ControlState,
    Inputs,
    Outcome,
    constrained,
    control_step,
    law_command,
    slowed,
)
from formation.control.tracker import MAX_DELAY
from formation.control.unicycle import AT_REST, Command
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.addressed import Addressee
from formation.protocol.attachment import PositionAttachment
from formation.protocol.lateness import LATE_GAIN, bearable_gain, own_age_limit
from formation.protocol.reasons import Code, Reason
from formation.protocol.request import OperatorRequest, ReplyCode
from formation.protocol.status import AgentState, MotionFault
from formation.protocol.status_codec import to_message
from formation.ros2.messages import Pose, encode
from formation.slots.geofence import Geofence
from formation.topics import POSITION, STATUS, Topic
from formation.wire import BadMessage, Now, Outgoing, Sample

STATUS_PERIOD = 0.5
"""[s]"""


@dataclass(slots=True, kw_only=True)
class CoreState:
    """All that an agent has learned: its commands depend on this, its mission, and what it receives next."""

    here: LocalisationState
    neighbours: NeighbourhoodState
    avoiding: AvoidingState
    perception: PerceptionState | None
    answers: AnswersState
    orders: OrdersState
    tuning: TuningState
    slots: SlotsState
    availability: Availability
    motion: MotionCheckState
    probe: ProbeState
    wakefulness: Wakefulness
    commander: CommanderState
    latch: LatchState
    inbox: InboxState
    decision: Decision
    sent: int = 0
    """Number of positions sent."""
    surroundings: Surroundings = field(default_factory=Surroundings)
    rival: float = float("-inf")
    """When another agent's sign of life was last received [s, monotonic]."""
    moved: bool = False
    """Whether an own position came in the newest step."""
    integral: complex = 0j
    """The law's integral."""
    finite: bool = True
    """Whether the newest command was finite."""
    outside: Reason | None = None
    """How it is outside the bounds."""
    status_due: float = float("-inf")
    """[s, monotonic]"""
    rest_due: float = float("-inf")
    """[s, monotonic]"""


class Agent:
    """One follower's controller."""

    def __init__(
        self,
        mission: Mission,
        robot: str,
        law: str | None = None,
        *,
        readonly: bool = False,
        publisher_id: str = "",
        certificate: Callable[[float], str] = lambda mono: "",  # noqa: ARG005
    ) -> None:
        """Use the mission's law unless `law` is given; `publisher_id`: drawn at random at every start.

        `readonly`: its commands do not reach the robot. `certificate` returns the candidate's certificate to
        send to the neighbours at that time [s, monotonic], or "". Raises ValueError for a robot that is no
        follower of the mission.
        """
        if robot not in mission.followers:
            followers = ", ".join(mission.followers)
            raise ValueError(f"robot {robot!r}: must be a follower of {mission.name}: {followers}")
        if (why := why_unusable(law or mission.law.kind)) is not None:
            raise ValueError(why)
        spec = mission.robots[robot]
        self.robot = robot
        self.controller = law_of(law or mission.law.kind)
        """Its control law."""
        self.mission, self._spec = mission, spec
        self.readonly, self.publisher_id = readonly, publisher_id
        self._certificate = certificate
        self._params = mission.control(robot, self.controller)
        self.here = Localisation(mission, robot, self.controller)
        self.neighbours = Neighbourhood(mission, robot, self.controller)
        self.avoiding = Avoiding(mission, robot, self.controller)
        self.perception = Perception(mission, robot) if mission.landmarks_of(robot) else None
        """Corrects its pose by what its scanner sees of neighbours; None for a robot that does not."""
        self._answers = Answers(mission, robot, self.others)
        self._fence, self._addressee = Geofence(mission), Addressee(mission)
        self.orders = Orders(mission, votes=not readonly)
        self.tuning = Tuning(mission, robot, self.controller)
        self._slots = Slots(mission, robot)
        self.motion = MotionCheck(mission, robot)
        self.commander = Commander(mission, robot)
        self._probe = Probe(spec.limits, self.commander.steps, self.motion.model.longest)
        self.latch = Latch(robot, readonly=readonly)
        self._status_key, self._position_key = STATUS.key(robot), POSITION.key(robot)
        self.inbox = Inbox(
            mission,
            robot,
            self.here,
            self.neighbours,
            self.avoiding,
            self.perception,
            self.orders,
            self._answers,
            self._fence,
            self._watch_motion,
        )
        self.state = CoreState(
            here=self.here.state,
            neighbours=self.neighbours.state,
            avoiding=self.avoiding.state,
            perception=None if self.perception is None else self.perception.state,
            answers=self._answers.state,
            orders=self.orders.state,
            tuning=self.tuning.state,
            slots=self._slots.state,
            availability=Availability(),
            motion=self.motion.state,
            probe=self._probe.state,
            wakefulness=Wakefulness(),
            commander=self.commander.state,
            latch=self.latch.state,
            inbox=self.inbox.state,
            decision=Decision(AgentState.WAITING, Reason(Code.STARTED)),
        )

    @property
    def decision(self) -> Decision:
        """What it does now, and why."""
        return self.state.decision

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Every key that this agent subscribes to: own position, neighbours and robots that it avoids."""
        return self.inbox.keys

    @property
    def dropped(self) -> Counter[str]:
        """Messages that were not used, by key."""
        return self.inbox.state.dropped

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key this agent publishes."""
        topics = (*self.commander.topics, POSITION, STATUS)
        return tuple((topic, topic.key(self.robot)) for topic in topics)

    @property
    def command(self) -> Command:
        """The newest command."""
        return self.commander.state.newest

    @property
    def due(self) -> float:
        """When a step is needed though nothing arrives [s, monotonic]."""
        if self._drives:
            return min(self.state.status_due, self.here.stream.stale_at, self.avoiding.blind_at)
        return min(self.state.status_due, self.state.rest_due)

    def aware(self, surroundings: Surroundings) -> None:
        """Store how the process is connected; call this before a step."""
        self.state.surroundings = surroundings

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Process `inbox`, decide, and return the messages to send."""
        return [*self.act(now, inbox), *self.tell(now)]

    def act(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Run the first half of a step, which must not wait for the second: learn, decide, command."""
        voter, rival = self.orders.voter, self.state.surroundings.rival and not self.readonly
        if rival:
            self.state.rival = now.mono
        voter.aware(now.mono, rival=rival)
        self.state.moved, interval = self.inbox.process_inbox(self._without_stale(now, inbox), now)
        if self.state.moved:
            voter.commanded(now.mono)
            before = self.state.outside is not None
            self.state.outside = self._fence.outside(self.here.state.position, before=before)
        gains, degree = self.tuning.state, self.controller.degree(len(self._spec.neighbours))
        k_p = min(gains.k_p, LATE_GAIN) if self.controller.mean else gains.k_p
        self.here.state.age_limit = own_age_limit(degree, k_p, gains.k_i, self._spec.rate, MAX_DELAY)
        self.here.judge_age()
        if self.perception is not None and self.state.moved:
            self.perception.step(self.here, self.others, now)
        self.neighbours.judge(self.here.state.age_limit, now)
        self.avoiding.expect(self.here, self.neighbours, now)
        decided, self.state.decision = self.state.decision.state, self._decide(now)
        outbox = self._drive(now, interval) if self.state.moved else self._rest(now)
        ordered = self.orders.newest
        self.state.availability.judge(self.state.decision, ordered, now.mono)
        if self._rests_by_operator:
            self._probe.rearm()
            self.neighbours.trust_all(now.mono)
            self.here.trust()
            if self.perception is not None:
                self.perception.trust()
        if self.decision.state is not decided:
            self.state.status_due = now.mono
        if self._tells_position:  # here, as a replica of this agent only acts
            self._answers.record_sent(self.here.stream.state.stamp, now.mono)
        return outbox

    @property
    def _rests_by_operator(self) -> bool:
        """Whether an operator holds or stops the robot, and so looks after what it distrusts.

        A leader that is not driven orders to hold as well.
        """
        ordered = self.orders.newest
        if self.latch.mode is not None or ordered is None:
            return self.latch.mode is not None and not is_own(self.latch.state.why)
        return ordered.mode == "stop" or (ordered.mode == "hold" and ordered.holding)

    @property
    def _tells_position(self) -> bool:
        """Whether this step publishes a position: one in doubt would mislead robots that measure this one."""
        return self.state.moved and self.here.state.jumped is None and self.here.doubt is None

    def _without_stale(self, now: Now, inbox: Sequence[Sample]) -> Sequence[Sample]:
        """Return the messages of `inbox` without those that waited while this process was frozen."""
        wakefulness = self.state.wakefulness
        if wakefulness.step(now.mono):
            self.here.doubt_all()
            self.neighbours.doubt_all()
            self.avoiding.doubt_all()
            if self.perception is not None:
                self.perception.doubt_all()
            self.orders.doubt()
        if not wakefulness.pause:
            return inbox
        fresh = [sample for sample in inbox if not wakefulness.waited(sample.arrived)]
        for sample in inbox:
            if wakefulness.waited(sample.arrived):
                self.inbox.drop(sample.key, BadMessage("waited while this process was frozen"))
        return fresh

    def tell(self, now: Now) -> list[Outgoing]:
        """Run the second half: return the position, if it is new, and the status when it is due."""
        outbox = []
        if self._tells_position:
            outbox.append(self._position(now))
        if now.mono >= self.state.status_due:
            self.state.status_due = now.mono + STATUS_PERIOD
            outbox.append(self._status(now))
        return outbox

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """Return an ending agent's last messages: zero velocity, and the reason.

        The second is made only after the first has been taken: making it may fail.
        """
        rest = self.latch.state.rest
        rest.stop = rest.stop or HALTED
        self.state.decision = Decision(AgentState.STOP, Reason.of(Code.ENDED, cause=reason))
        return chain(self.commander.leave(now), map(self._status, (now,)))

    def request(self, data: bytes, received: float) -> bytes:
        """Answer a request received at `received` [s, monotonic]; it takes effect in the next step."""
        ordered = self.orders.newest.mode if self.orders.newest else "hold"
        try:
            request = json_message.decode(OperatorRequest, data)
        except BadMessage as bad:
            self.inbox.drop("order", bad)
            return self.latch.reply(ordered, ok=False, reason=str(bad))
        return self._addressee.answer(
            request,
            lambda: self.latch.request(request, received, ordered, self._unreached),
            lambda: self.latch.reply(ordered, ok=False),
        )

    @property
    def _unreached(self) -> ReplyCode:
        """Why commands do not reach the robot; empty if they do, or if unknown."""
        if self.readonly:
            return "readonly"
        if self.state.surroundings.connected is False:
            return "no-link"
        return "no-listener" if self.state.surroundings.routed is False else ""

    def _decide(self, now: Now) -> Decision:
        self.neighbours.choose(now)
        self.state.wakefulness.confirm(beat_rose=self.orders.state.rose, follows=self.here.state.follows)
        return failsafe.decide(facts(self, now))

    @property
    def others(self) -> tuple[Neighbour, ...]:
        """The neighbours, and the robots that only the collision filter uses."""
        return *self.neighbours.each.values(), *self.avoiding.others.values()

    def _drive(self, now: Now, interval: float | None) -> list[Outgoing]:
        """A command for the newest position; zero velocity unless the failsafe table says run."""
        self.neighbours.place(self.here)
        wanted = self.orders.newest
        if wanted is not None:
            self.here.joins(wanted)
        probes = self.state.decision.probes
        retries = self._retries_law(now)
        drives = retries or probes or self.state.decision.state is AgentState.RUN
        if not drives or wanted is None:
            self.state.finite = True
            self.avoiding.rested()
            self._probe.interrupt()
            return self._at_rest(now)
        self._slots.follow(wanted, self.orders.state.rose, now.mono)
        leader = self.orders.leader(now.mono) if self.controller.mean else None
        what = self.neighbours.measured(self.here, self._slots, now, leader)
        dt = min(interval or 0.0, self.here.stream.limit)
        heading = self.here.heading
        gains, integral = self.tuning.follow(wanted, dt, self.state.integral, heading, what)
        if self.controller.mean:
            k_p = bearable_gain(gains.k_p, self.here.stream.age_on_arrival)
            gains = gains._replace(k_p=k_p)
        inputs = Inputs(now.mono, dt, heading, what, gains, self.here.speed(dt))
        if probes:
            return self._probed(now, integral, inputs)
        robots, strangers, sight = self.avoiding.obstacles(self.here, self.neighbours, now)
        before = self.commander.control_state(integral, self.avoiding.state.avoidance)
        state, outcome = control_step(
            before, inputs._replace(sight=sight), [*robots, *strangers], self._params
        )
        self.state.finite = outcome.finite
        if retries or not outcome.finite:
            return self._not_finite(now)
        self.state.availability.error = abs(error(heading, what)) / what.count
        if not self.readonly:  # the integral of a robot that does not move would only grow
            self.state.integral = state.integral
        return self._driven(now, state, outcome)

    def _probed(self, now: Now, integral: complex, inputs: Inputs) -> list[Outgoing]:
        """Send the probe's command instead of the law's; the integral stays as it is.

        The filter only brakes it, and gives its direction: a robot that may not move as commanded must not
        evade.
        """
        self.avoiding.rested()
        state = self.commander.control_state(integral, self.avoiding.state.avoidance)
        law_output, _, self.state.finite = law_command(state, inputs, self._params, self._params.limits)
        if not self.state.finite:
            return self._not_finite(now)
        robots, strangers, sight = self.avoiding.obstacles(self.here, self.neighbours, now)
        inputs = inputs._replace(sight=sight)
        _, wanted = constrained(state, law_output, inputs, [*robots, *strangers], self._params)
        trial = self._tried(now, wanted.target)
        if trial == AT_REST:
            return self._at_rest(now)
        # the protective zones alone limit it towards what only the scan shows
        inputs = inputs._replace(sight=self.avoiding.beside(sight, trial.speed, self._probe.kept))
        return self._driven(now, *slowed(state, trial, inputs, robots, self._params))

    def _driven(self, now: Now, state: ControlState, outcome: Outcome) -> list[Outgoing]:
        """Send the command of a control step, and store its state for the next."""
        self.avoiding.stepped(state, outcome)
        self.state.rest_due = float("-inf")  # a later stop takes effect at once
        return self._commanded(self.commander.say(now, outcome.command, state), now)

    def _retries_law(self, now: Now) -> bool:
        """Whether only the law's last result, which was not finite, keeps the robot from driving."""
        if self.state.finite:
            return False
        return failsafe.decide(facts(self, now)._replace(finite=True)).state is AgentState.RUN

    def _not_finite(self, now: Now) -> list[Outgoing]:
        """Send zero velocity: the law's command or integral is not finite, or was not in the last step."""
        self.state.decision, self.state.integral = self._decide(now), 0j
        return self._at_rest(now)

    @property
    def _drives(self) -> bool:
        return self.decision.state is AgentState.RUN or (self.decision.probes and self._probe.moves)

    def _watch_motion(self, arrived: float) -> None:
        """Compare the own measurement that arrived [s, monotonic] with what was commanded."""
        motion, here = self.motion, self.here.state
        known = motion.state.doubt
        self.neighbours.moved(arrived, here.travel if known is None else None)
        if self.perception is not None:
            self.perception.moved(arrived, self.here)
        if self.readonly:
            return
        motion.saw(arrived, here.since_last, gap=here.travel is None, age_limit=here.age_limit)
        if known is not None:
            self._probe.saw(arrived, here.since_last, motion.model.now)
        elif motion.state.doubt is not None:
            self._probe.begin()
            if motion.state.doubt.kind in {MotionFault.CARRIED, MotionFault.TURNED}:
                self.here.carried()
        elif motion.state.confirmed:
            self._probe.rearm()

    def _tried(self, now: Now, wanted: Command) -> Command:
        """Return a command of the probe, while the robot does not move as commanded."""
        doubt, motion = self.motion.state.doubt, self.motion
        if doubt is None:
            return AT_REST
        speeds = self.here.source == "odometry"
        limit = self.here.state.age_limit + motion.excused
        if self._probe.verdict(now.mono, doubt, limit, speeds=speeds):
            motion.trust()
            return AT_REST
        motion.model.go_to(now.mono)
        return self._probe.step(now.mono, doubt, motion.model.now, wanted)

    def _rest(self, now: Now) -> list[Outgoing]:
        """Send zero velocity every period while the robot must not move: commands may get lost."""
        if self._drives or now.mono < self.state.rest_due:
            return []
        self.state.rest_due = now.mono + 1.0 / self._spec.rate
        return self._at_rest(now)

    def _at_rest(self, now: Now) -> list[Outgoing]:
        return self._commanded(self.commander.rest(now), now)

    def _commanded(self, outbox: list[Outgoing], now: Now) -> list[Outgoing]:
        """Pass the newest command to the models of the robot."""
        if not self.readonly:
            self.here.commanded(now.mono, self.commander.state.newest)
            self.motion.model.commanded(now.mono, self.commander.state.newest)
            if self.avoiding.scanner is not None and self._spec.localisation != "odometry":
                self.avoiding.scanner.commanded(now.mono, self.commander.state.newest)
        return outbox

    def _position(self, now: Now) -> Outgoing:
        self.state.sent += 1
        orders = self.state.orders
        voter, newest, (signed, signature) = orders.voter, orders.newest, orders.signed
        certificate = self._certificate(now.mono)
        attachment = PositionAttachment(
            publisher_id=self.publisher_id,
            count=self.state.sent,
            order=None if certificate else newest,
            order_age=0.0 if newest is None or newest.motion is None else round(self.orders.age(now.mono), 4),
            stale=not certificate and self.orders.stale(now.mono),
            signed="" if certificate else signed,
            signature="" if certificate else signature,
            certificate=certificate,
            term=newest.term if certificate and newest is not None else 0,
            readonly=self.readonly,
            unavailable=self.state.availability.published,
            searching=self.perception is not None and not self.perception.placed(now),
            voted_term=voter.voted_term,
            last_ballot=voter.last_ballot,
            mission=self.mission.tag,
            refused=voter.refused,
            because=voter.because,
            received=self._answers.next_named(),
        )
        pose = Pose(self.here.stream.state.stamp, self.here.state.position, self.here.heading)
        return Outgoing(self._position_key, encode(pose), json_message.encode(attachment))

    def _status(self, now: Now) -> Outgoing:
        return Outgoing(self._status_key, encode(to_message(status(self, now), now.wall)))
