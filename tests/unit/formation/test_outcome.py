"""What came of an order: what counts as obeyed, who is missing, and how it is told."""

from __future__ import annotations

from typing import Any

import pytest

from formation.protocol.order import UNREACHED, OperatorReply, OperatorRequest
from formation.protocol.outcome import Answer, Outcome, Recipients, called

STOP = OperatorRequest(do="stop", id="1a")
RUN = OperatorRequest(do="run")
EVERYBODY = Recipients(("leader", "spare"), ("robot1", "robot2"))


def answer(robot: str, **result: Any) -> Answer:
    return Answer(OperatorReply.model_validate({"robot": robot, "ok": True, "mode": "stop", **result}), 2.0)


def outcome(request: OperatorRequest, recipients: Recipients, *answers: Answer) -> Outcome:
    return Outcome(request, recipients, {one.reply.robot: one for one in answers}, 1e9, 3.0)


ROBOTS = (answer("robot1"), answer("robot2"))
LEADS, LED = answer("leader", leads=True), answer("spare", leads=True)
SPARE = answer("spare", leads=False)


def test_request_is_obeyed_when_robots_and_leader_obey() -> None:
    assert outcome(STOP, EVERYBODY, *ROBOTS, LEADS).obeyed
    assert outcome(STOP, EVERYBODY, *ROBOTS, LEADS, SPARE).obeyed
    assert not outcome(STOP, EVERYBODY, ROBOTS[0], LEADS).obeyed


def test_a_dead_leader_is_not_missed_when_another_leads() -> None:
    one = outcome(STOP, EVERYBODY, *ROBOTS, LED)
    assert (one.obeyed, one.leader, one.missing) == (True, "spare", [])
    assert "leader      no answer; spare leads" in one.words()


def test_a_leader_that_does_not_know_of_standbys_leads() -> None:
    assert outcome(RUN, Recipients(("leader",)), answer("leader")).leader == "leader"


@pytest.mark.parametrize("others", [(), (SPARE,)])
def test_missing_leader_is_reported_and_stop_still_holds(
    others: tuple[Answer, ...],
) -> None:
    one = outcome(STOP, EVERYBODY, *ROBOTS, *others)
    assert (one.obeyed, one.leader, one.missing) == (False, None, ["leader"])
    assert one.summary().startswith("stop: 2 of 3 obey, slowest 2 ms; no answer from leader")
    assert one.summary().endswith("robots that obey stand, with a leader or without")


def test_a_refusal_is_shown_with_its_reason() -> None:
    result = answer("leader", ok=False, reason="release it first", leads=True)
    one = outcome(RUN, Recipients(("leader",)), result)
    assert (one.obeyed, one.missing, one.refused) == (False, [], ["leader"])
    assert "REFUSED" in one.words()
    assert "release it first" in one.words()
    assert "run: 0 of 1 obey" in one.words()


def test_a_long_name_is_not_glued_to_what_its_robot_says() -> None:
    long = "a-robot-of-a-very-long-name"
    result = answer("leader", ok=False, reason="release it first", leads=True)
    one = outcome(RUN, Recipients(("leader",), (long, "robot2")), result, answer(long), ROBOTS[1])
    leader, other, short, _ = one.words().splitlines()
    assert f"  {long}  stop " in other
    assert leader.index("REFUSED") == other.index("stop") == short.index("stop")


def test_standby_neither_obeys_nor_refuses() -> None:
    one = outcome(RUN, Recipients(("leader", "spare")), LEADS, answer("spare", ok=False, leads=False))
    assert (one.obeyed, one.refused, one.standby) == (True, [], ["spare"])
    assert one.summary() == "run: 1 of 1 obey, slowest 2 ms"
    assert "spare       stands by" in one.words()


def test_release_says_that_robots_hold_until_run() -> None:
    request = OperatorRequest(do="release", ends=("s",))
    one = outcome(request, Recipients(("leader",), ("robot1",)), answer("leader", mode="hold"), ROBOTS[0])
    leader, robot, last = one.words().splitlines()
    assert (leader.split()[:2], robot.split()[:2]) == (["leader", "released"], ["robot1", "released"])
    assert last == "release: 2 of 2 obey, slowest 2 ms; all robots hold until you order run"
    assert one.report()["ends"] == ["s"]


def test_a_release_names_robots_without_a_stop_and_without_an_answer() -> None:
    leader, robot = (answer(name, code="nothing", mode="hold") for name in ("leader", "robot1"))
    one = outcome(OperatorRequest(do="release"), EVERYBODY, leader, robot)
    assert one.refused == []
    assert one.summary().endswith(
        "; nothing to release at leader, robot1; robot2 may still be stopped: release again"
    )


def test_incomplete_run_reports_possibly_held_robot() -> None:
    one = outcome(RUN, EVERYBODY, LEADS, ROBOTS[0])
    assert not one.obeyed
    assert one.summary().endswith("no answer from robot2; robot2 may still be held: order run again")


@pytest.mark.parametrize(("do", "verdict"), [("stop", "NOT STOPPED"), ("hold", "NOT HELD")])
@pytest.mark.parametrize("code", sorted(UNREACHED))
def test_a_robot_out_of_reach_is_named_with_what_to_do(do: str, verdict: str, code: str) -> None:
    lost = answer("robot1", ok=False, code=code, reason="latched, but no link")
    request = OperatorRequest.model_validate({"do": do})
    one = outcome(request, EVERYBODY, LEADS, lost, ROBOTS[1])
    assert (one.obeyed, one.unreached, one.missing) == (False, ["robot1"], [])
    assert f"{verdict}: robot1: use the robot's own switch" in one.summary()
    assert f"  robot1      {verdict}" in one.words()
    (refused,) = one.report()["refused"]
    assert (refused["code"], one.report()["unreached"]) == (code, ["robot1"])


def test_report_lists_acknowledged_refused_and_missing_robots() -> None:
    refuses = answer("robot1", ok=False, reason="no")
    assert outcome(STOP, EVERYBODY, LEADS, SPARE, refuses).report() == {
        "do": "stop",
        "id": "1a",
        "at": 1e9,
        "leader": "leader",
        "acknowledged": [{"robot": "leader", "ms": 2.0, "mode": "stop", "reason": ""}],
        "refused": [{"robot": "robot1", "ms": 2.0, "mode": "stop", "reason": "no"}],
        "missing": ["robot2"],
        "standby": ["spare"],
        "unreached": [],
        "advice": ["robot2 may still drive: use the robot's own switch"],
    }


@pytest.mark.parametrize(
    ("what", "result"),
    [
        ({"do": "shape", "shape": "wedge"}, "shape wedge"),
        ({"do": "rotate", "degrees": -30.0}, "rotate -30"),
        ({"do": "scale", "factor": 1.5}, "scale 1.5"),
        ({"do": "speed", "speed": 0.1, "degrees": 90.0}, "speed 0.1 90"),
        ({"do": "route", "legs": ({"speed": 0.1, "heading_deg": 0.0},)}, "route of one leg"),
        ({"do": "hold"}, "hold"),
    ],
)
def test_an_order_is_called_as_it_was_typed(what: dict[str, Any], result: str) -> None:
    assert called(OperatorRequest.model_validate(what)) == result
