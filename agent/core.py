"""The agent: one follower's controller, without a clock, a socket or a log.

`Agent.step(now, inbox) -> outbox` takes what its few subscriptions brought and gives what it has to say,
commands first. It is driven by what tells its own position, odometry or a camera above: newest neighbours,
law, command, at once. A step without that only watches for silence.
"""

from __future__ import annotations

import cmath
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import chain

from agent import failsafe
from agent.aside import Aside
from agent.avoiding import Avoiding, Brake
from agent.commander import AT_REST, Commander
from agent.failsafe import Decision, Facts, State
from agent.hearing import Hearing
from agent.latch import HALTED, Latch
from agent.localisation import Localisation
from agent.motion_check import Kind, MotionCheck
from agent.neighbourhood import Neighbourhood, other_missions
from agent.orders import Orders
from agent.probe import Probe
from agent.slots import Slots
from agent.status import Report, Surroundings, status
from agent.tuning import Tuning
from agent.wakefulness import Wakefulness
from formation import order
from formation.geofence import Geofence
from formation.lateness import own_age_limit
from formation.law import LAWS, error, unwound
from formation.mission import Mission
from formation.neighbour import LONGEST_WAY
from formation.order import Code, OperatorRequest, Told
from formation.ros2.messages import Pose, encode
from formation.topics import POSITION, STATUS, Topic
from formation.unicycle import Command
from formation.wire import BadMessage, Now, Outgoing, Sample

STATUS_PERIOD = 0.5
"""[s]"""
RIVAL = 1.0
"""After another agent's sign of life the robot holds for so long [s], and for 3 periods at least."""


class Agent:
    """One follower's controller."""

    def __init__(
        self,
        mission: Mission,
        robot: str,
        law: str | None = None,
        *,
        readonly: bool = False,
        voice: str = "",
        certificate: Callable[[float], str] = lambda mono: "",  # noqa: ARG005
    ) -> None:
        """Its law is the mission's unless `law` says otherwise; its `voice` is drawn anew at every start.

        `readonly`: nobody passes its commands on, so the robot does not do what they say. `certificate` gives
        the candidate's certificate that its neighbours are to have now [s, monotonic], or nothing. Raises
        ValueError for a robot that is no follower of the mission.
        """
        if robot not in mission.followers:
            followers = ", ".join(mission.followers)
            raise ValueError(f"robot {robot!r}: must be a follower of {mission.name}: {followers}")
        if law is not None and law not in LAWS:
            raise ValueError(f"law {law!r}: must be one of {', '.join(LAWS)}")
        spec = mission.robots[robot]
        self.robot = robot
        self.law_name = law or mission.law.kind
        self.decision = Decision(State.WAITING, "just started")
        self._mission, self._spec = mission, spec
        self._readonly, self._voice, self._told = readonly, voice, 0
        self._certificate = certificate
        self._surroundings = Surroundings()
        self._rival = float("-inf")  # when another agent's sign of life was last received [s, monotonic]
        self._moved = False  # by the newest step
        self._law = LAWS[self.law_name]
        self._here = Localisation(mission, robot, self.law_name)
        self._neighbours = Neighbourhood(mission, robot, self.law_name)
        self._avoiding = Avoiding(mission, robot, self.law_name)
        self._integral = 0j
        self._finite = True
        self._fence = Geofence(mission)
        self._outside: str | None = None  # how it is outside the bounds, in words
        self._orders = Orders(mission, votes=not readonly)
        self._tuning = Tuning(mission, robot)
        self._slots = Slots(mission, robot)
        self._aside = Aside()
        self._motion = MotionCheck(mission, robot)
        self._commander = Commander(mission, robot, self.law_name)
        self._probe = Probe(spec.limits, self._commander.steps, self._motion.model.longest)
        self._latch = Latch(robot)
        self._wakefulness = Wakefulness()
        self._status_due = float("-inf")
        self._rest_due = float("-inf")
        self._status_key, self._position_key = STATUS.key(robot), POSITION.key(robot)
        self._hearing = Hearing(
            mission,
            robot,
            self._here,
            self._neighbours,
            self._avoiding,
            self._orders,
            self._fence,
            self._watch_motion,
        )

    @property
    def subscriptions(self) -> tuple[str, ...]:
        """Every key this agent listens to: what tells its own position, its neighbours, whom it minds."""
        return self._hearing.keys

    @property
    def dropped(self) -> Counter[str]:
        """Messages that were not used, by key."""
        return self._hearing.dropped

    @property
    def publications(self) -> tuple[tuple[Topic, str], ...]:
        """Every topic and key this agent publishes."""
        topics = (*self._commander.topics, POSITION, STATUS)
        return tuple((topic, topic.key(self.robot)) for topic in topics)

    @property
    def command(self) -> Command:
        """The newest command."""
        return self._commander.newest

    @property
    def due(self) -> float:
        """When a step is wanted though nothing arrives [s, monotonic]."""
        if self._drives:
            return min(self._status_due, self._here.stream.stale_at, self._avoiding.blind_at)
        return min(self._status_due, self._rest_due)

    def aware(self, surroundings: Surroundings) -> None:
        """Learn how the process around is connected; to be called before a step."""
        self._surroundings = surroundings

    def step(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """Learn from `inbox`, decide, and say what follows from it."""
        return [*self.act(now, inbox), *self.tell(now)]

    def act(self, now: Now, inbox: Sequence[Sample]) -> list[Outgoing]:
        """The first half of a step, whose result need not wait for the second: learn, decide, command."""
        voter, rival = self._orders.voter, self._surroundings.rival and not self._readonly
        if rival:
            self._rival = now.mono
        voter.aware(now.mono, rival=rival)
        self._moved, interval = self._hearing.take(self._unstale(now, inbox), now)
        if self._moved:
            voter.commanded(now.mono)
            self._outside = self._fence.outside(self._here.position, before=self._outside is not None)
        self._here.age_limit = own_age_limit(
            len(self._spec.neighbours), self._tuning.k_p, self._tuning.k_i, self._spec.rate, LONGEST_WAY
        )
        self._here.judge_age()
        before, self.decision = self.decision.state, self._decide(now)
        outbox = self._drive(now, interval) if self._moved else self._rest(now)
        ordered = self._orders.newest
        self._aside.judge(self.decision, ordered, now.mono)
        if ordered is None or ordered.mode != "run" or self._latch.mode is not None:
            self._probe.rearm()
        if self.decision.state is not before:
            self._status_due = now.mono
        return outbox

    def _unstale(self, now: Now, inbox: Sequence[Sample]) -> Sequence[Sample]:
        """The messages of `inbox` that did not wait while this process was frozen."""
        wakefulness = self._wakefulness
        if wakefulness.step(now.mono):
            self._here.doubt_all()
            self._neighbours.doubt_all()
            self._avoiding.doubt_all()
            self._orders.doubt()
        if not wakefulness.pause:
            return inbox
        fresh = [sample for sample in inbox if not wakefulness.waited(sample.arrived)]
        for sample in inbox:
            if wakefulness.waited(sample.arrived):
                self._hearing.drop(sample.key, BadMessage("waited while this process was frozen"))
        return fresh

    def tell(self, now: Now) -> list[Outgoing]:
        """The second half: where this robot is, if it has just learned that, and now and then how it does."""
        outbox = []
        here = self._here  # whoever measures a robot that is in doubt about it would be misled as well
        if self._moved and here.jumped is None and here.doubt is None:
            outbox.append(self._position(now))
        if now.mono >= self._status_due:
            self._status_due = now.mono + STATUS_PERIOD
            outbox.append(self._status(now))
        return outbox

    def halt(self, now: Now, reason: str) -> Iterable[Outgoing]:
        """The last words of an agent that ends: zero velocity, and why.

        The latter is made only when the former has been taken: it may be what the agent fails for.
        """
        self._latch.rest.stop, self.decision = HALTED, Decision(State.STOP, reason)
        return chain(self._commander.leave(now), map(self._status, (now,)))

    def request(self, data: bytes, heard: float) -> bytes:
        """Answer what an operator asked at `heard` [s, monotonic]; it takes effect with the next step."""
        ordered = self._orders.newest.mode if self._orders.newest else "hold"
        try:
            request = order.decode(OperatorRequest, data)
            return self._latch.ask(request, heard, ordered, self._unreached)
        except BadMessage as bad:
            self._hearing.drop("order", bad)
            return self._latch.reply(ordered, ok=False, reason=str(bad))

    @property
    def _unreached(self) -> Code:
        """Why commands do not reach the robot; empty if they do, or if that is unknown."""
        if self._readonly:
            return "readonly"
        if self._surroundings.connected is False:
            return "no-link"
        return "no-listener" if self._surroundings.routed is False else ""

    def _decide(self, now: Now) -> Decision:
        around, scanner = self._neighbours, self._avoiding.scanner
        around.choose(now)
        self._wakefulness.confirm(beat_rose=self._orders.rose, follows=self._here.follows)
        return failsafe.decide(
            Facts(
                latched=self._latch.mode,
                why=self._latch.why,
                source=self._here.source,
                connected=self._surroundings.connected,
                routed=None if self._readonly else self._surroundings.routed,
                silence=self._here.stream.silence(now),
                limit=self._here.stream.limit,
                jumped=self._here.jumped,
                doubt=self._here.doubt,
                outside=self._outside,
                beyond=() if around.guides else around.beyond,
                too_old=self._here.trust.held,
                age=self._here.age,
                age_limit=self._here.age_limit,
                follows=self._here.follows,
                order=self._orders.newest,
                beat_silence=now.mono - self._orders.rose,
                neighbours=around.silences(now),
                fresh=len(around.guides),
                aside=() if around.guides else around.aside(now),
                unsigned=self._orders.unsigned(now),
                leaderless=not around.guides and around.leaderless(now),
                motion=self._motion.doubt,
                frozen=self._wakefulness.pause,
                finite=self._finite,
                rival=now.mono - self._rival <= max(RIVAL, self._here.stream.limit),
                mission=self._mission.tag,
                other_missions=self._other_missions(now),
                scan_silence=0.0 if scanner is None else scanner.silence(now),
                scan_limit=math.inf if scanner is None else scanner.stream.limit,
                scan_doubt=scanner.doubt if scanner is not None and scanner.required else None,
            )
        )

    def _other_missions(self, now: Now) -> dict[str, str]:
        """Robots that this one measures or avoids and that run another mission, with its tag."""
        return other_missions(chain(self._neighbours.each.values(), self._avoiding.others.values()), now)

    def _drive(self, now: Now, interval: float | None) -> list[Outgoing]:
        """A command for the newest position; zero velocity unless the failsafe table says run."""
        self._neighbours.place(self._here)
        wanted = self._orders.newest
        if wanted is not None:
            self._here.joins(wanted)
        probes = self.decision.probes
        if not (probes or self.decision.state is State.RUN) or wanted is None:
            self._finite = True
            self._avoiding.rested()
            self._probe.interrupt()
            return self._commanded(now, AT_REST)
        self._slots.follow(wanted, self._orders.rose, now.mono)
        what = self._neighbours.measured(self._here, self._slots, now)
        dt = min(interval or 0.0, self._here.stream.limit)
        heading, limits = self._here.heading, self._spec.limits
        gains, integral = self._tuning.follow(wanted, dt, self._integral, heading, what)
        said, integral = self._law(integral, heading, what, gains, limits, dt)
        self._finite = cmath.isfinite(complex(said.speed, said.turn_rate)) and cmath.isfinite(integral)
        if not self._finite:
            self.decision, self._integral = self._decide(now), 0j
            return self._commanded(now, AT_REST)
        trial = self._tried(now, said) if probes else said
        if probes and trial == AT_REST:
            self._avoiding.rested()
            return self._commanded(now, AT_REST)
        along = heading.conjugate() * what.velocity
        command, brake = self._avoiding.command(trial, along, self._here, self._neighbours, now, dt)
        if not probes:
            integral = unwound(integral, heading, what, gains, limits, said, command, dt)
            self._aside.drove(abs(error(heading, what)) / what.count)
            if not self._readonly:  # what does not move cannot be integrated away
                self._integral = integral
        self._rest_due = float("-inf")  # whatever stops it takes hold at once
        return self._commanded(now, command, brake)

    @property
    def _drives(self) -> bool:
        """Whether the robot is to move just now."""
        return self.decision.state is State.RUN or (self.decision.probes and self._probe.moves)

    def _watch_motion(self, arrived: float) -> None:
        """An own measurement arrived [s, monotonic]: does it agree with what was commanded?"""
        if self._readonly:
            return
        motion, travel = self._motion, self._here.travel
        known = motion.doubt
        motion.saw(arrived, travel)
        if known is not None:
            self._probe.saw(travel)
        elif motion.doubt is not None:
            self._probe.interrupt()
            if motion.doubt.kind in {Kind.CARRIED, Kind.TURNED}:
                self._here.carried()
        elif motion.confirmed:
            self._probe.rearm()

    def _tried(self, now: Now, wanted: Command) -> Command:
        """A command of the probe, while the robot does not move as it is told."""
        doubt, motion = self._motion.doubt, self._motion
        if doubt is None:
            return AT_REST
        speeds = self._here.source == "odometry"
        if self._probe.verdict(now.mono, doubt, speeds=speeds):
            motion.trust()
            self._probe.interrupt()
            return AT_REST
        motion.model.go_to(now.mono)
        return self._probe.step(now.mono, doubt, motion.model.now, wanted)

    def _rest(self, now: Now) -> list[Outgoing]:
        """A robot that must not move is told so every period: there may be no position, commands get lost."""
        if self._drives or now.mono < self._rest_due:
            return []
        self._rest_due = now.mono + 1.0 / self._spec.rate
        return self._commanded(now, AT_REST)

    def _commanded(self, now: Now, wanted: Command, brake: Brake | None = None) -> list[Outgoing]:
        outbox = self._commander.say(now, wanted, brake)
        if not self._readonly:
            self._here.told(now.mono, self._commander.newest)
            self._motion.told(now.mono, self._commander.newest)
            if self._avoiding.scanner is not None and self._spec.localisation != "odometry":
                self._avoiding.scanner.told(now.mono, self._commander.newest)
        return outbox

    def _position(self, now: Now) -> Outgoing:
        self._told += 1
        voter, newest, (signed, signature) = self._orders.voter, self._orders.newest, self._orders.signed
        certificate = self._certificate(now.mono)
        told = Told(
            voice=self._voice,
            count=self._told,
            order=None if certificate else newest,
            signed="" if certificate else signed,
            signature="" if certificate else signature,
            certificate=certificate,
            term=newest.term if certificate and newest is not None else 0,
            aside=self._aside.told,
            promise=voter.promise,
            echo=voter.echo,
            mission=self._mission.tag,
            refused=voter.refused,
            because=voter.because,
        )
        pose = Pose(self._here.stream.stamp, self._here.position, self._here.heading)
        return Outgoing(self._position_key, encode(pose), order.encode(told))

    def _status(self, now: Now) -> Outgoing:
        report = Report(
            robot=self.robot,
            law=self.law_name,
            decision=self.decision,
            readonly=self._readonly,
            commander=self._commander,
            here=self._here,
            neighbours=self._neighbours,
            avoiding=self._avoiding,
            aside=self._aside.told,
            motion=self._motion.doubt,
            gains=self._tuning.told,
            surroundings=self._surroundings,
            dropped=self._hearing.unused,
            forgers=self._orders.forgers(now),
            mission=self._mission.fingerprint,
            other_missions=self._other_missions(now),
        )
        return Outgoing(self._status_key, encode(status(report, now)))
