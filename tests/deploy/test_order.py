"""An operator's word: who is asked, how often, and what counts as obeyed."""

from __future__ import annotations

import json
from collections.abc import Sequence

import pytest

from deploy import order as operator
from deploy.cli import main
from formation import order
from formation.order import Mode, OperatorReply, OperatorRequest
from formation.transport.bus import Reply

STOP = OperatorRequest(do="stop")


def reply(robot: str, *, ok: bool = True, mode: Mode = "stop", key: str = "") -> Reply:
    said = OperatorReply(robot=robot, ok=ok, mode=mode)
    return Reply(key or f"{robot}/order", order.encode(said), 1.5)


class Fleet:
    """Answers each question with the next of the given lists of replies, then with nothing."""

    def __init__(self, *rounds: Sequence[Reply]) -> None:
        self.rounds = list(rounds)
        self.keys: list[str] = []

    def ask(self, key: str, payload: bytes, timeout: float) -> Sequence[Reply]:
        assert order.decode(OperatorRequest, payload) == STOP
        assert 0.0 < timeout <= operator.ROUND
        self.keys.append(key)
        return self.rounds.pop(0) if self.rounds else []


def test_a_question_is_put_again_until_everybody_has_answered() -> None:
    fleet = Fleet([], [reply("robot1")], [reply("robot1"), reply("robot2")], [reply("robot2")])
    answers = operator.ask(fleet.ask, ["robot1", "robot2"], STOP, 10.0)
    assert set(answers) == {"robot1", "robot2"}
    assert fleet.keys == ["*/order"] * 3


def test_one_robot_is_asked_by_its_own_key() -> None:
    fleet = Fleet([reply("robot1")])
    operator.ask(fleet.ask, ["robot1"], STOP, 10.0)
    assert fleet.keys == ["robot1/order"]


def test_who_does_not_answer_in_time_is_missing() -> None:
    fleet = Fleet(*[[reply("robot1")]] * 1000)
    answers = operator.ask(fleet.ask, ["robot1", "robot2"], STOP, 0.1)
    assert set(answers) == {"robot1"}
    assert operator.report("stop", ["robot1", "robot2"], answers)["missing"] == ["robot2"]
    assert "no answer from robot2" in operator.words("stop", ["robot1", "robot2"], answers, 0.1)


def test_answers_that_are_garbage_or_of_strangers_or_in_anothers_name_count_for_nothing() -> None:
    strange = [
        Reply("robot1/order", b"yes", 1.0),
        reply("robot9"),
        reply("robot2", key="robot1/order"),
    ]
    answers = operator.ask(Fleet(strange).ask, ["robot1", "robot2"], STOP, 0.05)
    assert answers == {}


def test_a_refusal_is_shown_with_its_reason() -> None:
    said = OperatorReply(robot="robot1", ok=False, mode="stop", reason="release it first")
    answers = {"robot1": operator.Answer(said, 2.0)}
    text = operator.words("run", ["robot1"], answers, 3.0)
    assert "REFUSED" in text
    assert "release it first" in text
    assert "run: 0 of 1 obey" in text


def test_who_is_released_is_called_that_and_a_leader_that_goes_on_says_so() -> None:
    modes = {"leader": "run", "robot1": "stop"}
    said = {
        name: OperatorReply.model_validate({"robot": name, "ok": True, "mode": mode})
        for name, mode in modes.items()
    }
    answers = {name: operator.Answer(reply, 2.0) for name, reply in said.items()}
    leader, robot, last = operator.words("release", list(said), answers, 3.0).splitlines()
    assert (leader.split()[:2], robot.split()[:2]) == (["leader", "run"], ["robot1", "released"])
    assert last == "release: 2 of 2 obey"


def test_with_nobody_there_the_command_names_all_that_are_missing(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["order", "turtlebot3_pair", "stop", "--timeout", "0.3", "--json", "-e", "tcp/127.0.0.1:9"])
    result = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert code == 1
    assert result == {"do": "stop", "robots": {}, "missing": ["leader", "robot1", "robot2"]}


def test_an_endpoint_that_is_none_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["order", "six_robots", "stop", "-e", "nonsense"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
