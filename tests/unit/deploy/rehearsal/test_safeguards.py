"""A rehearsal detects a defect of each safeguard, even if another safeguard has the same effect."""

from __future__ import annotations

from typing import Any

import pytest

from formation.agent.following.publisher import AcceptedPublisher
from formation.agent.persistence.restore import Taken
from formation.agent.safety import failsafe
from formation.agent.safety.commander import Commander
from formation.control.quantiser import quantise
from formation.control.unicycle import AT_REST, Command
from formation.deploy.rehearsal.faults import parse
from formation.deploy.rehearsal.operator import Operator
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, run
from formation.leader.plan import Plan as LeaderPlan
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol.election import Voter
from formation.protocol.order import Order
from formation.protocol.stops import Result
from formation.ros2.messages import Twist, encode
from formation.wire import Outgoing
from tests.campaigns.defects.plan import MISSIONS
from tests.support.examples import slow
from tests.support.missions import with_robots

PAIR, SIX, PATROL, POSTS = map(load, ("turtlebot3_pair", "six_robots", "patrol", "posts"))
AVOIDING = with_robots("turtlebot3_pair", avoid="all")
TRIO, MEASURED, BLOCKED, PAPER, CROWD, FENCED = (
    load(MISSIONS / f"{name}.toml")
    for name in ("trio", "measured", "blocked", "trio_paper", "crowd", "fenced")
)
ORDER = Order(term=64, beat=7, mode="run", shape="line")
RUNNING = failsafe.Facts(
    latched=None, silence=0.0, limit=1.0, jumped=None, order=ORDER, beat_silence=0.0, neighbours={},
    followed=1,
)  # fmt: skip


def rehearsed(mission: Mission, faults: str = "", **plan: Any) -> Verdict:
    return run(Plan(mission, **plan), 0, tuple(parse(one, mission) for one in faults.split()))


def without_row(**facts: Any) -> dict[str, Any]:
    """Patch: the failsafe table without the row that decides about these facts."""
    row = next(one for one in failsafe.TABLE if one.applies(RUNNING._replace(**facts)))
    return {"agent.safety.failsafe.TABLE": tuple(one for one in failsafe.TABLE if one is not row)}


def nothing(*_: Any, **__: Any) -> None:
    """Do nothing, in place of a method that safeguards."""


def obeys_run(rest: Any, _: Any) -> Result:
    rest.hold = ""
    return Result(ok=True)


def released(rest: Any, *_: Any) -> Result:
    rest.stop = ""
    return Result(ok=True)


def votes_at_once(voter: Voter, *given: Any, begin: Any = Voter.__init__, **options: Any) -> None:
    begin(voter, *given, **options)
    voter._quarantine = 0.0


def admits_any(publisher: Any, *given: Any, admit: Any = AcceptedPublisher.admit) -> None:
    try:
        admit(publisher, *given)
    finally:
        publisher.state.contested = float("-inf")


def orders_followers_only(operator: Operator, fleet: Any, begin: Any = Operator.__init__) -> None:
    begin(operator, fleet)
    operator._names = fleet.mission.followers


def drives_in_hold(commander: Any, _: Any) -> list[Outgoing]:
    key = commander._cmd_vel
    return [Outgoing(key, encode(Twist(0.2, 0.0)))] if key.startswith("robot2") else []


def commanding(command: Command) -> dict[str, Any]:
    """Patch: send `command` from two seconds on, in place of the law's."""
    say = Commander.say
    return {
        "agent.safety.commander.Commander.say": lambda one, now, wanted, state: say(
            one, now, command if now.mono > 1002.0 else wanted, state
        )
    }


IMPATIENT = {
    "deploy.rehearsal.rehearsal.START_TIME": 5.0,
    "deploy.rehearsal.rules.settling.RECOVERY_TIME": 5.0,
}
DEFECTS: dict[str, tuple[Mission, str, str, dict[str, Any]]] = {
    "follows a silent robot": (TRIO, "robot1:kill@3+2", "follow",
        {"agent.pose.stream.Stream.fresh": lambda stream, _: stream.state.arrived is not None}),
    "does not name a lost leader": (PAIR, "leader:kill@6+4", "follow", without_row(beat_silence=9.0)),
    "takes late orders": (MEASURED, "robot1:late=0.5@3+8", "orders",
        {"agent.following.orders._check_late": nothing}),  # another safeguard refuses late positions
    "takes repeated positions": (TRIO, "robot1:again=2@4+10 robot1:kill@7+4", "orders",
        {"agent.following.publisher.AcceptedPublisher._judge": nothing}),
    "tears the file of stops": (TRIO, "robot1:stop@3+4 robot2:torn@4+2", "restored",
        {"deploy.rehearsal.fleet.FailingPath.with_suffix": lambda path, _: path}),
    "tears the file of states": (TRIO, "robot1:torn@3+1", "restored",
        {"deploy.rehearsal.fleet.state_in": lambda data: data}),
    "forgets a vote": (TRIO, "robot1:kill@3+2", "restored",
        {"agent.persistence.restore.Restorer.take_saved": lambda *_: Taken(None, "")}),
    "restores an old integral": (PAPER, "robot1:kill@3+6", "restored",
        {"agent.persistence.restore.MAX_INTEGRAL_AGE": 60.0}),
    "votes at once": (TRIO, "robot1:kill@3+2", "votes",
        {"protocol.election.Voter.__init__": votes_at_once}),
    "runs while stopped": (PAIR, "robot1:stop@4+5 robot2:waver@5+2", "answer",
        {"protocol.stops.Rest._run": obeys_run}),
    "starts when released": (AVOIDING, "robot1:stop@5+3", "release",
        {"protocol.stops.Rest._release": released}),
    "is never released": (AVOIDING, "robot1:stop@3+2", "formation",
        {"protocol.stops.Rest._release": lambda *_: Result(ok=False, code="another"), **IMPATIENT}),
    "does not wait for the disk": (AVOIDING, "robot1:full@4+5 robot1:stop@5+2", "stop",
        {"deploy.rehearsal.fleet.AgentFiles.written": lambda *_: True}),
    "never writes a stop": (AVOIDING, "robot1:stop@5+3", "stop",
        {"agent.persistence.persistence.Persistence.requested": nothing}),
    "forgets a stop": (TRIO, "robot1:stop@3+3", "stop",
        {"deploy.rehearsal.operator.Operator.__init__": orders_followers_only,
         "agent.safety.latch.Latch.mode": property(nothing)}),
    "leader does not inherit a stop": (TRIO,
        "robot1:stop@3+5 leader:kill@4+2 deputy:kill@4+2 reserve:kill@4+2", "stop",
        {"leader.plan.TeamMode.inherit_stop": nothing}),
    "drives in hold": (SIX, "", "zero", {"agent.safety.commander.Commander.rest": drives_in_hold}),
    "leader drives while the team rests": (PAIR, "robot1:hold@5+3", "zero",
        {"leader.plan.Plan.go_on":
         lambda plan, mono, dt, _, honest=LeaderPlan.go_on: honest(plan, mono, dt, "run")}),
    "drives beside a second agent": (AVOIDING, "robot1:second@3+4", "alone", without_row(rival=True)),
    "drives beside another mission": (AVOIDING, "robot2:mixed@5+4", "mission",
        without_row(other_missions={"robot2": "89ef4567"})),
    "drives after a kill": (PAIR, "robot1:kill@5+4", "watchdog",
        {"agent.watchdog.core.Watchdog._silent": lambda *_: False}),
    "drives while suspended": (PAIR, "robot1:freeze@5+2", "watchdog",
        {"agent.watchdog.core.Watchdog._silent": lambda *_: False}),
    "does not name a freeze": (PAIR, "robot1:freeze@5+2", "named",
        {"agent.inbox.Wakefulness.step": lambda *_: False}),
    "does not name wrong speeds": (TRIO, "robot3:speeds=0@4+6", "named",
        {"agent.pose.motion_check.MotionCheck._contradiction": nothing}),
    "does not name a frozen sensor": (MEASURED, "robot3:relative_frozen@3+8", "named",
        {"agent.following.relative_check.RelativeCheck.saw": nothing}),
    "does not name a frozen scanner": (POSTS, "robot1:scan_frozen@3+8", "named",
        {"agent.safety.scanner.Scanner._compare": nothing}),
    "does not name a second publisher": (TRIO, "robot1:second@3+4", "named",
        {"agent.following.publisher.AcceptedPublisher.admit": admits_any}),
    "counts repeated measurements": (PAIR, "robot1:repeat=0.12@4+2", "named",
        {"agent.pose.stream.Stream._agree": lambda *_: True}),
    "drives on late positions": (PAIR, "robot2:stale=0.5@4+8", "blind",
        {"agent.core.own_age_limit": lambda *_: 100.0}),
    "drives on frozen positions": (PAIR, "robot2:frozen@4+8", "blind",
        {"agent.pose.motion_check.MAX_COMMAND_LOOP_DELAY": 100.0}),
    "leader waits too long": (TRIO, "robot3:blocked@3+9", "wait",
        {"leader.cohesion.Cohesion._given_up": lambda *_: set()}),
    "takes no detour": (BLOCKED, "robot2:kill@0.5 robot3:kill@0.5", "detour",
        {"control.avoidance.DEADLOCK_DELAY": 500.0}),
    "does not brake": (CROWD, "", "brake",
        {"control.avoidance.brake": lambda wanted, *_: wanted,
         "control.pipeline.brake": lambda wanted, *_: wanted}),
    "adds up what it rounds": (PAIR, "", "steps",
        {"control.pipeline.quantise": lambda quantiser, wanted, _: quantise(quantiser, wanted, AT_REST)}),
    "commands too fast": (TRIO, "", "limits", commanding(Command(3.0, 0.0))),
    "commands too suddenly": (TRIO, "", "ramp", commanding(Command(-0.8, 0.0))),
    "two candidates lead": (PATROL, "", "leaders", {"leader.candidacy.Candidacy.lease_end":
         property(lambda one: float("inf") if one._rank < 2 else 0.0)}),
    "leader stays killed": (PAIR, "leader:kill@6+1", "led", {"deploy.rehearsal.fleet.Fleet.start": nothing}),
    "holds without fault": (PAIR.changed(simulated_robot=PAIR.simulated_robot.model_copy(
         update={"position_noise": 0.005})), "", "hold", {"agent.pose.sources.JUMP_DEVIATIONS": 0.0}),
    "leaves its bounds": (FENCED, "", "bounds",
        {"leader.plan.Plan._fenced": nothing, "slots.geofence.Geofence.outside": nothing,
         "slots.geofence.Geofence.check": nothing, "slots.geofence.Geofence.holds": lambda *_: True}),
    "wide bodies": (SIX.changed(robots={name: one.model_copy(update={"radius": 1.0})
                                        for name, one in SIX.robots.items()}), "", "touch", {}),
}  # fmt: skip


FIRST = {rule: defect for defect, (_, _, rule, _) in reversed(DEFECTS.items())}.values()
"""One defect for each rule; the others are slow tests."""


@pytest.mark.parametrize("defect", [*FIRST, *slow(*(one for one in DEFECTS if one not in FIRST))])
def test_rule_detects_defect_of_safeguard(defect: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mission, faults, rule, changes = DEFECTS[defect]
    for name, instead in changes.items():
        monkeypatch.setattr(f"formation.{name}", instead)
    assert rule in rehearsed(mission, faults).broken


HEALTHY = {name: one for name, one in DEFECTS.items() if name not in {"holds without fault", "wide bodies"}}
"""Defects of the program, not of the mission."""


@pytest.mark.slow
@pytest.mark.parametrize("defect", {(id(one[0]), one[1]): name for name, one in HEALTHY.items()}.values())
def test_every_rule_holds_without_the_defect(defect: str) -> None:
    mission, faults, *_ = DEFECTS[defect]
    assert rehearsed(mission, faults).violations == ()


@pytest.mark.parametrize(
    ("mission", "faults"),
    [
        (TRIO, "robot1:kill@3+2 robot3:torn@6+1 robot1:stop@8+2 leader:kill@9+6"),
        *slow(
            (PAIR, "robot1:freeze@3+1 robot2:repeat=0.12@5+2 robot1:hold@6+2 leader:kill@9+4"),
            (AVOIDING, "robot1:full@3+4 robot1:stop@4+2 robot1:second@7+2 robot2:mixed@10+3"),
        ),
    ],
)
def test_every_rule_holds_with_one_fault_after_another(mission: Mission, faults: str) -> None:
    assert rehearsed(mission, faults).violations == ()


@pytest.mark.parametrize(("mission", "seed"), [*slow((TRIO, 0)), (PAIR, 3)])
def test_every_rule_holds_with_late_answers_to_a_wavering_operator(mission: Mission, seed: int) -> None:
    """A robot answers a repeated hold although it has obeyed the next run meanwhile."""
    faults = tuple(parse(one, mission) for one in ("robot2:waver@5+4", "robot2:loss=0.6@5+6"))
    assert run(Plan(mission), seed, faults).violations == ()
