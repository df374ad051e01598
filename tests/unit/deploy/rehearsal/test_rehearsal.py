"""Rehearsals with and without faults, and the output of `formation rehearse`."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from formation.agent.persistence.persistence import Persistence
from formation.agent.simulated.faults import Fault
from formation.deploy.refusal import Refusal
from formation.deploy.rehearsal import rehearsal
from formation.deploy.rehearsal.air import Weather
from formation.deploy.rehearsal.faults import (
    INSIDERS,
    KINDS,
    KINDS_AND_SIZES,
    SECOND_RUN_TIME,
    draw,
    parse,
    spelled,
)
from formation.deploy.rehearsal.fleet import Fleet
from formation.deploy.rehearsal.rehearsal import Plan, Verdict, rehearse, run, shrunk
from formation.deploy.rehearsal.rules.judge import RULES, Violation
from formation.deploy.rehearse import main
from formation.deploy.testing.pytest_plugin import MakeRehearsed
from formation.mission.file import load, read
from formation.mission.model import Mission
from tests.campaigns.defects.plan import MISSIONS
from tests.support.examples import slow
from tests.unit.deploy.commands import Capsys

SIX, PATROL, PAIR = load("six_robots"), load("patrol"), load("turtlebot3_pair")
MEASURED, POSTS, CONVOY = load(MISSIONS / "measured.toml"), load("posts"), load("convoy")
LOSSY: dict[str, Any] = {"weather": Weather(loss=0.1)}
WITH_SENSOR = {
    "restart": (PAIR, "robot1"),
    **{f"relative_{how}": (MEASURED, "robot3") for how in ("frozen", "late")},
    **{f"scan_{how}": (POSTS, "robot1") for how in ("frozen", "late")},
}
"""Kinds of faults that need a sensor which six_robots lacks, and a robot that has it."""


def faults(*texts: str, mission: Any = SIX) -> tuple[Fault, ...]:
    return tuple(parse(text, mission) for text in texts)


def rehearsed(*texts: str, mission: Any = SIX, seed: int = 0) -> Verdict:
    return run(Plan(mission), seed, faults(*texts, mission=mission))


def breaks(verdict: Verdict, rule: str) -> bool:
    assert rule in RULES
    return rule in verdict.broken


@pytest.mark.parametrize("name", ["six_robots", *slow("patrol", "two_chains")])
def test_every_rule_holds_without_faults(name: str) -> None:
    verdict = run(Plan(load(name)), 0, ())
    assert verdict.violations == ()
    assert verdict.settled_at is not None
    assert verdict.nearest > 0.0


@pytest.mark.slow
def test_odometry_drift_does_not_break_formation_rule() -> None:
    drifting = PAIR.simulated_robot.model_copy(update={"drift": 0.1})
    verdict = run(Plan(PAIR.model_copy(update={"simulated_robot": drifting})), 0, ())
    assert not breaks(verdict, "formation")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_rule_holds_with_each_fault(kind: str) -> None:
    usual = SIX, "robot3" if KINDS[kind].robots_only else "robot1"
    mission, name = WITH_SENSOR.get(kind, usual)
    plan = Plan(mission, signed=kind in INSIDERS)
    assert run(plan, 0, faults(f"{name}:{kind}@6+4", mission=mission)).violations == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_every_rule_holds_with_drawn_faults(seed: int) -> None:
    assert rehearse(Plan(PATROL, tuple(KINDS)), seed).violations == ()


def test_spelled_faults_parse_to_the_same_faults() -> None:
    for seed in range(20):
        drawn = draw(PATROL, tuple(KINDS), seed)
        assert tuple(drawn) == faults(*map(spelled, drawn), mission=PATROL)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("robot2:kill", r"must be NAME:KIND\[=SIZE\]@START\[\+SECONDS\]"),
        ("robot2:melt@3", "melt: must be one of loss, delay, .*, carried"),
        ("robot9:kill@3", "robot9: must be one of robot1, robot2"),
        ("robot1:frozen@3", "robot1: must be one of robot2, robot3"),
        ("robot2:kill@3s", "such as robot2:frozen@20[+]10; numbers without units"),
        ("robot2:loss=20@3", "SIZE must be from 0 to 1$"),
        ("robot2:throttle=0@3", "SIZE must be from 1 to 100000 bytes/s"),
        ("robot2:kill@3600+1", r"START \+ SECONDS must be at most 3600 s"),
        ("robot2:kill@3601", r"START \+ SECONDS must be at most 3600 s"),
        ("robot2:scan_frozen@3", "robot2 has no sensor for scan_frozen; no robot of the mission has one"),
    ],
)
def test_parse_of_illegal_fault_names_legal_values(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        parse(text, SIX)


def test_size_that_a_rehearsal_draws_is_legal() -> None:
    for name, kind in KINDS.items():
        legal = KINDS_AND_SIZES[name]
        assert (legal is None) == (kind.lowest == kind.highest == 0.0), name
        assert legal is None or not any(map(legal.illegal, (kind.lowest, kind.highest, legal.usual))), name


def test_run_lasts_until_endless_fault_has_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "START_TIME", 1.0)
    verdict = rehearsed("leader:kill@4", mission=PAIR)
    assert verdict.settled_at is None
    assert verdict.seconds > 4.0 + 1.0


def test_progress_rises_within_one_seed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "START_TIME", 2.0)
    shares: list[float] = []
    run(Plan(PAIR), 0, (), shares.append)
    assert len(shares) > 10
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 0.1
    assert shares[-1] == 1.0


def test_formation_rule_is_not_judged_after_endless_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "START_TIME", 5.0)
    assert not breaks(rehearsed("leader:kill@3", mission=PAIR), "formation")


@pytest.mark.slow
@pytest.mark.parametrize(
    "texts",
    [
        ("robot1:stop@22.5+7.5", "leader:reset@25+6.2"),  # the stop reaches the leader after its release
        ("robot1:waver@18.3+5.5", "robot2:again=2.6@18.5+6.4"),
    ],
)
def test_rest_that_arrives_after_newer_run_ends_with_second_run(texts: tuple[str, ...]) -> None:
    verdict = rehearsed(*texts, mission=PAIR, seed=50001)
    last = max(one.since + one.lasts for one in verdict.faults)
    assert verdict.violations == ()
    assert verdict.settled_at is not None
    assert verdict.settled_at > last + SECOND_RUN_TIME


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "seed", "plan", "texts"),
    [
        # odometry began anew, and the agent that knew it lost its state
        (PAIR, 400098, {"signed": True}, "robot2:restart@6+3.6 robot2:torn@20.4+9.4"),
        # the position froze while it was late, which was noticed first
        (PAIR, 300173, LOSSY, "robot2:stale=3.65@11.9+4.1 robot2:tremble=0.000391@12.2+5.9"),
        # carried beside a wall, which it may only leave backwards
        (POSTS, 1000070, LOSSY, "robot2:carried=0.219@22.6+4.6"),
        # hardly moved when its position froze, stood, and drove off
        (SIX, 2000671, {}, "robot3:frozen@8.6+5.1 robot2:torn@10.2+4.9 robot6:frozen@14.9+9.1"),
        # released, and no answer of it arrived
        (POSTS, 2000876, LOSSY, "robot5:stop@5+9.8 robot1:loss=0.557@11.6+5.4"),
        # restarted while its position was frozen
        (PAIR, 2000453, {}, "robot2:frozen@17.4+6.5 robot2:kill@19.6+2.7"),
        # carried to a post, which it may only leave backwards
        (POSTS, 2000396, {}, "robot3:carried=0.24@20.5+3.7"),
        # a run and a hold within two milliseconds
        (PATROL, 1000251, {}, "robot3:hold@18+6.9 reserve:waver@24.6+5.2"),
        # turned back as its position froze
        (CONVOY, 4500027, {}, "robot4:carried=0.155@11.3+6.7 robot2:tremble=0.00063@23.9+5.6"),
        # in its slot, a centimetre there and back
        (
            CONVOY,
            4000148,
            {"weather": Weather(delay=0.05)},
            "robot1:loss=0.167@3.4+8.7 robot1:waver@8+3.7 robot2:torn@8.5+9.4 robot4:stutter=0.396@19.5+6.3",
        ),
    ],
)
def test_seeds_that_broke_a_rule_hold_every_rule(
    mission: Mission, seed: int, plan: dict[str, Any], texts: str
) -> None:
    verdict = run(Plan(mission, **plan), seed, faults(*texts.split(), mission=mission))
    assert verdict.violations == ()


def test_stated_position_noise_does_not_break_hold_rule() -> None:
    noisy = PAIR.changed(
        simulated_robot=PAIR.simulated_robot.model_copy(update={"position_noise": 0.005}),
        collisions=PAIR.collisions.model_copy(update={"noise": 0.005}),
    )
    assert not breaks(run(Plan(noisy), 0, ()), "hold")


def test_positions_within_age_limit_break_no_rule() -> None:
    verdict = rehearsed("robot2:stale=0.1@3+9", mission=PAIR)
    assert verdict.violations == ()
    assert verdict.blind_path == 0.0


@pytest.mark.slow
def test_mujoco_world_passes_rules_and_refuses_sensor_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    pytest.importorskip("mujoco")
    plan = Plan(SIX, world="mujoco")
    assert run(plan, 0, ()).violations == ()
    with pytest.raises(ValueError, match="frozen: needs the kinematic world"):
        run(plan, 0, faults("robot2:frozen@3"))


def test_shrunk_keeps_only_the_fault_that_breaks_a_rule(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Persistence, "requested", lambda _: None)  # no stop is saved
    monkeypatch.setattr(rehearsal, "START_TIME", 5.0)
    plan = Plan(PAIR)
    given = faults("robot2:twice@2+2", "leader:stop@3+2", "robot1:full@2+2", mission=PAIR)
    assert shrunk(plan, run(plan, 0, given)) == given[1:2]


def test_operator_request_is_answered_beside_and_after_second_agent() -> None:
    fleet, replies = Fleet(PAIR, 0, Weather(), ()), list[bytes]()
    fleet.engine.run(2.0)
    fleet.start_rival("robot2")
    fleet.engine.run(3.0)
    for number in (2, 3):
        fleet.fleet.ask("desk", "robot2/order", b'{"do":"hold"}', replies.append)
        fleet.engine.run(fleet.engine.now + 0.1)
        assert len(replies) == number
        fleet.rivals["robot2"].kill()


LOCAL = read("six_robots")[0].replace("rate = 20 ", 'rate = 20\nmeasurement = "local" #')


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mission", "fault", "reason"),
    [
        pytest.param(LOCAL, "robot3:relative_late=1@6+4", "sensor", id="relative"),
        pytest.param("posts", "robot3:scan_late=1@6+4", "scan", id="scan"),
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


def test_robot_with_torn_state_file_logs_it_and_settles(
    rehearsed_fleet: MakeRehearsed, caplog: pytest.LogCaptureFixture
) -> None:
    fleet = rehearsed_fleet("turtlebot3_pair", faults=["robot2:torn@3+2"])
    fleet.run(5.5)
    assert "not written to its end" in caplog.text
    fleet.run_until_settled(within=60.0)


def test_rehearse_without_faults_prints_every_rule_held(capsys: Capsys) -> None:
    assert main(["turtlebot3_pair", "--faults", "none"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("turtlebot3-pair, 1 seed, faults: none\n  every rule held  1 of 1\n")


@pytest.mark.parametrize(
    ("rule", "printed"),
    [
        ("touch", "seed 0: overlapped by 11 cm"),
        (None, "seed 0: overlapped by 11 cm (rule touch: not judged with this fault, law or mission)"),
    ],
)
def test_overlap_is_printed_with_whether_it_was_judged(
    capsys: Capsys, monkeypatch: pytest.MonkeyPatch, rule: str | None, printed: str
) -> None:
    broken = () if rule is None else (Violation(rule, 1.0, "robot1", "bodies overlap"),)
    monkeypatch.setattr(
        "formation.deploy.rehearse.rehearse",
        lambda _, seed, **_progress: Verdict(seed, (), broken, 1.0, -0.11, 1.0),
    )
    monkeypatch.setattr("formation.deploy.rehearse.shrunk", lambda _, verdict: verdict.faults)
    main(["turtlebot3_pair", "--faults", "none"])
    assert f"  nearest bodies   {printed}\n" in capsys.readouterr().out


def test_failing_run_is_printed_with_command_to_repeat_it(
    capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("formation.agent.core.Agent.tell", lambda *_: 1 // 0)
    arguments = ["six_robots", "--fault", "robot1:stop@8+5"]
    assert main(arguments) == 1
    out = capsys.readouterr().out
    assert "  seed 0: exception: " in out
    assert "    formation rehearse six_robots --seed 0 --faults none\n" in out
    assert main([*arguments, "--json"]) == 1
    report = json.loads(capsys.readouterr().out)
    assert report["failed"] == 1
    assert report["runs"][0]["violations"][0]["rule"] == "exception"


def test_rehearse_draws_given_fault_kinds_for_each_seed(
    capsys: Capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        rehearsal,
        "run",
        lambda _, seed, drawn, _progress: Verdict(seed, drawn, (), settled_at=1.0, nearest=1.0, seconds=1.0),
    )
    assert main(["turtlebot3_pair", "--faults", "clock,full", "--seeds", "9", "--json"]) == 0
    runs = json.loads(capsys.readouterr().out)["runs"]
    assert [run["seed"] for run in runs] == list(range(9))
    assert {re.split("[:=@]", fault)[1] for run in runs for fault in run["faults"]} == {"clock", "full"}
    drawn = runs[0]["faults"]
    assert main(["turtlebot3_pair", "--faults", "clock,full", "--fault", "robot1:cut@9+1"]) == 0
    assert f"\n  drawn            {', '.join(drawn)}\n" in capsys.readouterr().out


def test_only_kinds_that_the_mission_can_have_are_counted(capsys: Capsys) -> None:
    assert main(["turtlebot3_pair", "--faults", "all", "--fault", "robot1:cut@9"]) in {0, 1}
    out = capsys.readouterr().out
    lacking = sum(kind.endswith(("_frozen", "_late")) for kind in KINDS) + len(INSIDERS)
    assert f"faults: robot1:cut@9, all {len(KINDS) - lacking} kinds\n" in out
    assert "  settled by       not judged, for want of an end: robot1:cut@9; add +SECONDS\n" in out


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--faults", "kill,melt"], "--faults 'melt': must be all, none, or some of loss, "),
        (
            ["--faults", "kill,scan_frozen"],
            "--faults 'scan_frozen': no robot of the mission can have it; must ",
        ),
        (["--faults", "kill,forge"], "--faults 'forge': needs --signed"),
        (["--fault", "robot2:melt@3"], "--fault 'robot2:melt@3': melt: must be one of "),
    ],
)
def test_illegal_faults_are_refused(arguments: list[str], why: str) -> None:
    with pytest.raises(Refusal) as refused:
        main(["six_robots", *arguments])
    assert str(refused.value).startswith(why)
