"""Rehearsals: what holds with and without faults, what the command prints; a seed gives one run."""

from __future__ import annotations

import json
from typing import Any

import pytest

from formation.agent.core import Agent
from formation.agent.safety.commander import Commander
from formation.agent.simulated.faults import Fault
from formation.control.unicycle import Command
from formation.deploy.refusal import Refusal
from formation.deploy.rehearsal import rehearsal
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.faults import INSIDERS, KINDS, SENSORS, draw, parse, spelled
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.operator import Operator
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, rehearse, run, shrunk
from formation.deploy.rehearsal.rules import judge
from formation.deploy.rehearse import main
from formation.deploy.testing.pytest_plugin import MakeRehearsed
from formation.leader.candidacy import Candidacy
from formation.mission.file import load, read
from formation.protocol.order import OperatorReply
from formation.protocol.status import AgentState
from formation.ros2.messages import Twist, encode
from formation.topics import CMD_VEL
from formation.wire import Outgoing
from tests.unit.deploy.commands import Capsys

SIX, PATROL, PAIR = load("six_robots"), load("patrol"), load("turtlebot3_pair")


def faults(*texts: str, mission: Any = SIX) -> tuple[Fault, ...]:
    return tuple(parse(text, mission) for text in texts)


def rehearsed(*texts: str, mission: Any = SIX, seed: int = 0) -> Verdict:
    return run(Plan(mission), seed, faults(*texts, mission=mission))


@pytest.mark.parametrize(
    "name",
    ["six_robots", "patrol", pytest.param("two_chains", marks=pytest.mark.slow), "turtlebot3_pair"],
)
def test_every_rule_holds_without_faults(name: str) -> None:
    verdict = run(Plan(load(name)), 0, ())
    assert verdict.violations == ()
    assert verdict.settled_at is not None
    assert verdict.nearest > 0.0


def test_the_drift_of_odometry_is_no_broken_rule() -> None:
    drifting = PAIR.simulated_robot.model_copy(update={"drift": 0.1})
    verdict = run(Plan(PAIR.model_copy(update={"simulated_robot": drifting}), seconds=60.0), 0, ())
    assert "formation" not in {one.rule for one in verdict.violations}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_rule_holds_with_each_fault(kind: str) -> None:
    name = "robot3" if KINDS[kind].robots_only else "robot1"
    plan = Plan(SIX, signed=kind in INSIDERS)
    assert run(plan, 0, faults(f"{name}:{kind}@6+4")).violations == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_every_rule_holds_with_drawn_faults(seed: int) -> None:
    assert rehearse(Plan(PATROL, tuple(KINDS)), seed).violations == ()


def commands(monkeypatch: pytest.MonkeyPatch, seed: int) -> tuple[Verdict, list[tuple[float, Outgoing]]]:
    """A rehearsal and everything that was published in it."""
    published: list[tuple[float, Outgoing]] = []

    class Watched(Fleet):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            for exchange in (self.fleet, self.local):
                exchange.watchers.append(lambda _, out: published.append((self.engine.now, out)))

    monkeypatch.setattr(rehearsal, "Fleet", Watched)
    return rehearse(Plan(PAIR, tuple(KINDS), (), Weather(loss=0.1)), seed), published


def test_one_seed_gives_one_run(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = commands(monkeypatch, 3), commands(monkeypatch, 3)
    assert first[0] == second[0]
    assert first[1] == second[1]
    assert commands(monkeypatch, 4)[1] != first[1]


@pytest.mark.parametrize("seed", range(20))
def test_drawn_faults_are_spelled_as_they_are_parsed(seed: int) -> None:
    drawn = draw(PATROL, tuple(KINDS), seed)
    assert tuple(drawn) == faults(*map(spelled, drawn), mission=PATROL)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("robot2:kill", r"must be NAME:KIND\[=SIZE\]@START\[\+SECONDS\]"),
        ("robot2:melt@3", "melt: must be one of loss, delay, .*, carried"),
        ("robot9:kill@3", "robot9: must be one of robot1, robot2"),
        ("robot1:frozen@3", "robot1: must be one of robot2, robot3"),
    ],
)
def test_illegal_fault_is_refused_with_the_legal_ones(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse(text, SIX)


def forget_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have every robot acknowledge a stop and run on as soon as it is ordered to."""
    original = Operator.__init__

    def to_followers(self: Operator, fleet: Fleet) -> None:
        original(self, fleet)
        self._names = fleet.mission.followers

    monkeypatch.setattr(Operator, "__init__", to_followers)
    monkeypatch.setattr("formation.agent.safety.latch.Latch.mode", property(lambda _: None))


def test_killed_leader_stops_all_robots_until_it_is_back() -> None:
    verdict = rehearsed("leader:kill@8+5", mission=PAIR)
    assert verdict.violations == ()
    assert verdict.settled_at is not None
    assert "formation" not in rehearsed("leader:kill@8", mission=PAIR).broken, (
        "without an end nothing has to settle"
    )


def test_robot_that_drives_before_its_release_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    forget_stops(monkeypatch)
    verdict = rehearsed("robot1:stop@8+5")
    assert "stop" in verdict.broken


def test_command_in_hold_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def rest(self: Any, _: Any) -> list[Outgoing]:
        return (
            [Outgoing(CMD_VEL.key("robot2"), encode(Twist(0.2, 0.0)))]
            if self._cmd_vel.startswith("robot2")
            else []
        )

    monkeypatch.setattr("formation.agent.safety.commander.Commander.rest", rest)
    assert "zero" in rehearsed("robot1:hold@8+5").broken


@pytest.mark.parametrize(("command", "rule"), [(Command(3.0, 0.0), "limits"), (Command(1.0, 0.0), "ramp")])
def test_impossible_command_is_found(monkeypatch: pytest.MonkeyPatch, command: Command, rule: str) -> None:
    from formation.agent.safety.commander import Commander

    original = Commander.say

    def changed(self: Commander, now: Any, wanted: Command, state: Any) -> list[Outgoing]:
        return original(self, now, command if now.mono > 1010.0 else wanted, state)

    monkeypatch.setattr(Commander, "say", changed)
    assert rule in rehearsed().broken


def test_two_leaders_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        Candidacy, "lease_end", property(lambda self: float("inf") if self._rank < 2 else 0.0)
    )
    assert "leaders" in rehearsed(mission=PATROL).broken


def test_exception_of_a_process_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    original = Agent.act

    def fail(self: Agent, now: Any, inbox: Any) -> list[Outgoing]:
        if self.robot == "robot3" and now.mono > 1009.0:
            raise ZeroDivisionError("of today")
        return original(self, now, inbox)

    monkeypatch.setattr(Agent, "act", fail)
    (violation,) = [one for one in rehearsed().violations if one.rule == "exception"]
    assert violation.robot == "agent robot3"
    assert violation.what == "ZeroDivisionError: of today"


def test_touching_bodies_are_found() -> None:
    mission = SIX.changed(
        robots={name: spec.model_copy(update={"radius": 1.0}) for name, spec in SIX.robots.items()}
    )
    assert "touch" in run(Plan(mission), 0, ()).broken


def test_false_hold_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.agent.pose.sources.JUMP_DEVIATIONS", 0.0)
    noisy = PAIR.changed(simulated_robot=PAIR.simulated_robot.model_copy(update={"position_noise": 0.005}))
    assert "hold" in run(Plan(noisy), 0, ()).broken


def test_stated_noise_is_no_jump_of_odometry() -> None:
    noisy = PAIR.changed(
        simulated_robot=PAIR.simulated_robot.model_copy(update={"position_noise": 0.005}),
        collisions=PAIR.collisions.model_copy(update={"noise": 0.005}),
    )
    assert "hold" not in run(Plan(noisy), 0, ()).broken


@pytest.mark.parametrize(
    ("fault", "broken"),
    [
        ("robot2:stale=0.5@8+8", ("formation.agent.core.own_age_limit", lambda *_: 100.0)),
        ("robot2:frozen@8+8", ("formation.agent.pose.motion_check.MAX_COMMAND_LOOP_DELAY", 100.0)),
    ],
)
def test_robot_that_drives_on_wrong_positions_is_found(
    monkeypatch: pytest.MonkeyPatch, fault: str, broken: tuple[str, Any]
) -> None:
    assert rehearsed(fault, mission=PAIR).violations == ()
    monkeypatch.setattr(*broken)
    assert "blind" in rehearsed(fault, mission=PAIR).broken


def test_agent_may_act_on_positions_within_its_age_limit() -> None:
    verdict = rehearsed("robot2:stale=0.1@8", mission=PAIR)
    assert verdict.violations == ()
    assert verdict.blind_path == 0.0


@pytest.mark.slow
def test_robots_with_mass_are_rehearsed_without_sensor_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    pytest.importorskip("mujoco")
    plan = Plan(SIX, world="mujoco")
    assert run(plan, 0, ()).violations == ()
    with pytest.raises(ValueError, match="frozen: needs the kinematic world"):
        run(plan, 0, faults("robot2:frozen@3"))


def test_formation_that_does_not_settle_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "RECOVERY_TIME", 5.0)
    monkeypatch.setattr(judge, "RECOVERY_TIME", 5.0)
    verdict = rehearsed("robot2:full@1+1", mission=PAIR.changed(settled=-1.0))
    assert "formation" in verdict.broken
    (violation,) = [one for one in verdict.violations if one.rule == "formation"]
    assert "robot2: " in violation.what


def test_shrinking_leaves_the_fault_that_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    forget_stops(monkeypatch)
    plan = Plan(PAIR)
    given = faults("robot2:twice@5+3", "leader:stop@8+5", "robot1:full@6+3", mission=PAIR)
    assert shrunk(plan, run(plan, 0, given)) == given[1:2]


def test_restarted_agent_stays_stopped() -> None:
    plan = Plan(PAIR)
    fleets: list[Fleet] = []

    class Kept(Fleet):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            fleets.append(self)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rehearsal, "Fleet", Kept)
        verdict = run(plan, 0, faults("leader:stop@6", "robot2:kill@8+2", mission=PAIR))
    assert verdict.violations == ()
    agent, _ = fleets[0].agents["robot2"]
    assert agent.decision.state is AgentState.STOP


def test_every_process_is_there() -> None:
    fleet = Fleet(PATROL, 0, Weather(), ())
    fleet.engine.run(1.0)
    assert all(process.alive for process in fleet.processes)
    assert len(fleet.candidates) == 1 + len(PATROL.standbys)
    assert len(fleet.watchdogs) == len(fleet.agents) == len(PATROL.followers)


def test_answers_reach_an_operator() -> None:
    fleet, replies = Fleet(SIX, 0, Weather(), ()), list[bytes]()
    fleet.engine.run(2.0)
    fleet.fleet.ask("desk", "robot2/order", b'{"do":"hold"}', replies.append)
    fleet.engine.run(2.1)
    (reply,) = replies
    assert OperatorReply.model_validate_json(reply).robot == "robot2"


def test_sensor_faults_are_those_of_simulated_robots() -> None:
    assert set(SENSORS) <= set(KINDS)
    assert rehearsed("robot2:frozen@6+4", mission=PAIR).settled_at is not None


def test_agent_answers_beside_and_after_a_second_one() -> None:
    fleet, replies = Fleet(SIX, 0, Weather(), ()), list[bytes]()
    fleet.engine.run(2.0)
    fleet.start_rival("robot2")
    fleet.engine.run(3.0)
    for number in (2, 3):
        fleet.fleet.ask("desk", "robot2/order", b'{"do":"hold"}', replies.append)
        fleet.engine.run(fleet.engine.now + 0.1)
        assert len(replies) == number
        fleet.rivals["robot2"].kill()


LOCAL = read("six_robots")[0].replace("rate = 20 ", 'rate = 20\nmeasurement = "local" #')


@pytest.mark.parametrize(
    ("mission", "fault", "reason"),
    [
        pytest.param(LOCAL, "robot3:relative_late=1@6+4", "sensor", id="relative"),
        pytest.param("posts", "robot3:scan_late=1@6+4", "scan", id="scan", marks=pytest.mark.slow),
    ],
)
def test_robot_holds_while_a_sensor_is_late(
    rehearsed_fleet: MakeRehearsed, mission: str, fault: str, reason: str
) -> None:
    fleet = rehearsed_fleet(mission, faults=[fault])
    fleet.run(5.9)
    assert fleet.state("robot3") == "run"
    fleet.run(3.6)
    assert fleet.state("robot3") == "hold"
    assert reason in fleet.reason("robot3")
    before = fleet.position("robot3")
    fleet.run(0.4)
    assert abs(fleet.position("robot3") - before) < 0.01
    fleet.run_until_settled(within=60.0)


def test_robot_with_a_torn_state_starts_anew(
    rehearsed_fleet: MakeRehearsed, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = rehearsed_fleet("six_robots", faults=["robot3:torn@10+2"])
    fleet.run(12.5)
    assert "not written to its end" in caplog.text
    fleet.run_until_settled(within=60.0)


def told(capsys: Capsys, *arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json"]) in {0, 1}
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_calm_run_holds_every_rule(capsys: Capsys) -> None:
    assert main(["turtlebot3_pair", "--faults", "none"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("turtlebot3-pair, 1 seed, faults: none\n  every rule held  1 of 1\n")


def test_failing_run_is_told_with_its_command(capsys: Capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.agent.core.Agent.tell", lambda *_: 1 // 0)
    arguments = ("six_robots", "--fault", "robot1:stop@8+5")
    assert main(arguments) == 1
    out = capsys.readouterr().out
    assert "  seed 0: exception: " in out
    assert "    formation rehearse six_robots --seed 0 --faults none\n" in out
    report = told(capsys, *arguments)
    assert report["failed"] == 1
    assert report["runs"][0]["violations"][0]["rule"] == "exception"


def test_noise_is_stated_and_seeds_are_counted(capsys: Capsys) -> None:
    report = told(capsys, "turtlebot3_pair", "--faults", "clock,full", "--seeds", "2", "--noise", "0.001")
    assert [run["seed"] for run in report["runs"]] == [0, 1]
    kinds = {
        fault.split(":")[1].split("@")[0].split("=")[0] for run in report["runs"] for fault in run["faults"]
    }
    assert kinds <= {"clock", "full"}


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--faults", "kill,melt"], "--faults 'melt': must be all, none, or some of loss, "),
        (["--fault", "robot2:melt@3"], "--fault 'robot2:melt@3': melt: must be one of "),
    ],
)
def test_illegal_faults_are_refused(arguments: list[str], why: str) -> None:
    with pytest.raises(Refusal) as refused:
        main(["six_robots", *arguments])
    assert str(refused.value).startswith(why)
