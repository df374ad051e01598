"""Requests that name the mission: agents and leaders of another one obey only a stop and a hold."""

from __future__ import annotations

from typing import Any, get_args

import pytest

from formation.agent.core import Agent
from formation.control.laws import LAWS
from formation.leader.core import Leader
from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol import addressed, json_message
from formation.protocol.addressed import tags_of
from formation.protocol.outcome import Answer, Outcome, Recipients
from formation.protocol.request import Do, OperatorReply, OperatorRequest
from formation.stability import intent
from tests.unit.leader.leading import leading

SIX, CONVOY = load("six_robots"), load("convoy")
VALUES: dict[str, dict[str, Any]] = {
    "shape": {"shape": SIX.first_shape},
    "rotate": {"degrees": 10.0},
    "scale": {"factor": 1.1},
    "speed": {"speed": 0.01, "degrees": 0.0},
    "route": {"legs": [{"speed": 0.05, "heading_deg": 0.0, "duration": 1.0}]},
    "drive": {"forward": 0.1, "turn_rate": 0.0, "token": 0},
    "tune": {"k_p": 2.0},
}
every_do = pytest.mark.parametrize("do", get_args(Do))


def request(do: str, mission: Mission | None, number: int = 1) -> bytes:
    tag = mission.tag if mission else ""
    what = {"do": do, "id": f"{do}-{number}", "mission": tag, **VALUES.get(do, {})}
    return json_message.encode(OperatorRequest.model_validate(what))


def reply(process: Agent | Leader, data: bytes) -> OperatorReply:
    return json_message.decode(OperatorReply, process.request(data, 1.0))


@pytest.fixture(params=["agent", "leader"])
def process(request: pytest.FixtureRequest) -> Agent | Leader:
    return Agent(SIX, "robot2") if request.param == "agent" else leading(SIX)


@every_do
def test_only_stop_and_hold_of_another_mission_are_obeyed(process: Agent | Leader, do: str) -> None:
    answer = reply(process, request(do, CONVOY))
    assert (answer.ok, answer.code) == (do in {"stop", "hold", "query"}, "other-mission")
    assert answer.reason == (f"runs mission six-robots ({SIX.tag}), not the one of this order ({CONVOY.tag})")
    assert answer.mode == (do if do in {"stop", "hold"} else answer.mode)


def test_other_missions_release_and_run_leave_the_stop_in_force(process: Agent | Leader) -> None:
    stopped = reply(process, request("stop", SIX))
    assert (stopped.mode, stopped.code) == ("stop", "")
    for do in ("release", "run"):
        ends = OperatorRequest.model_validate(
            {"do": do, "id": do, "mission": CONVOY.tag, "ends": ("stop-1",)}
        )
        assert reply(process, json_message.encode(ends)).mode == "stop"
    ends = OperatorRequest(do="release", id="own", mission=SIX.tag, ends=("stop-1",))
    assert reply(process, json_message.encode(ends)).mode == "hold"


@every_do
@pytest.mark.parametrize("kind", LAWS)
def test_mission_is_the_same_under_each_law(process: Agent | Leader, kind: str, do: str) -> None:
    own, stated = (reply(process, request(do, one, 2)) for one in (None, SIX.under(kind)))
    assert "other-mission" not in {own.code, stated.code}
    assert SIX.under(kind).tag in tags_of(SIX)
    assert CONVOY.tag not in tags_of(SIX)


def test_mission_of_an_unusable_law_is_known_by_its_tag(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(addressed, "UNUSABLE", {"mine": "mine.py cannot be used: SyntaxError"})
    assert SIX.under("mine").tag in tags_of(SIX.under("mine"))


def test_order_states_the_mission_that_it_was_checked_against() -> None:
    assert intent.request_for(CONVOY, "rotate", degrees=40.0).mission == CONVOY.tag


def test_outcome_names_robots_of_another_mission_and_is_not_obeyed() -> None:
    asked = OperatorRequest(do="stop", mission=CONVOY.tag)
    answers = {
        name: Answer(reply(process, json_message.encode(asked)), 1.0)
        for name, process in (("robot1", leading(SIX)), ("robot2", Agent(SIX, "robot2")))
    }
    outcome = Outcome(asked, Recipients(("robot1",), ("robot2",)), answers, 0.0, 3.0)
    assert not outcome.obeyed
    assert outcome.elsewhere == ["robot1", "robot2"]
    assert "another mission runs at robot1, robot2: name that one" in outcome.summary()
    assert [one["code"] for one in outcome.report()["acknowledged"]] == ["other-mission"] * 2
