"""An operator's word: who is asked, how often, and what counts as obeyed."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from formation import order
from formation.mission_file import load
from formation.order import Do, Mode, OperatorReply, OperatorRequest
from formation.transport import asking
from formation.transport.bus import Reply

STOP = OperatorRequest(do="stop")
SIX = load("six_robots")


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
        assert 0.0 < timeout <= asking.ROUND
        self.keys.append(key)
        return self.rounds.pop(0) if self.rounds else []


def test_a_question_is_put_again_until_everybody_has_answered() -> None:
    fleet = Fleet([], [reply("robot1")], [reply("robot1"), reply("robot2")], [reply("robot2")])
    answers = asking.ask(fleet.ask, ["robot1", "robot2"], STOP, 10.0)
    assert set(answers) == {"robot1", "robot2"}
    assert fleet.keys == ["*/order"] * 3


def test_the_first_answer_of_a_robot_counts_and_not_what_it_says_to_the_repetition() -> None:
    late = reply("robot1", mode="hold")._replace(ms=400.0)
    answers = asking.ask(
        Fleet([reply("robot1")], [late, reply("robot2")]).ask, ["robot1", "robot2"], STOP, 10.0
    )
    assert answers["robot1"].ms == 1.5
    assert answers["robot1"].reply.mode == "stop"


def test_one_robot_is_asked_by_its_own_key() -> None:
    fleet = Fleet([reply("robot1")])
    asking.ask(fleet.ask, ["robot1"], STOP, 10.0)
    assert fleet.keys == ["robot1/order"]


def test_who_does_not_answer_in_time_is_missing() -> None:
    fleet = Fleet(*[[reply("robot1")]] * 1000)
    answers = asking.ask(fleet.ask, ["robot1", "robot2"], STOP, 0.1)
    assert set(answers) == {"robot1"}
    assert asking.report(STOP, ["robot1", "robot2"], answers)["missing"] == ["robot2"]
    assert "no answer from robot2" in asking.words(STOP, ["robot1", "robot2"], answers, 0.1)


def test_answers_that_are_garbage_or_of_strangers_or_in_anothers_name_count_for_nothing() -> None:
    strange = [
        Reply("robot1/order", b"yes", 1.0),
        reply("robot9"),
        reply("robot2", key="robot1/order"),
    ]
    answers = asking.ask(Fleet(strange).ask, ["robot1", "robot2"], STOP, 0.05)
    assert answers == {}


def test_a_refusal_is_shown_with_its_reason() -> None:
    said = OperatorReply(robot="robot1", ok=False, mode="stop", reason="release it first")
    answers = {"robot1": asking.Answer(said, 2.0)}
    text = asking.words(OperatorRequest(do="run"), ["robot1"], answers, 3.0)
    assert "REFUSED" in text
    assert "release it first" in text
    assert "run: 0 of 1 obey" in text


def test_who_is_released_is_called_that_and_a_leader_that_goes_on_says_so() -> None:
    modes = {"leader": "run", "robot1": "stop"}
    said = {
        name: OperatorReply.model_validate({"robot": name, "ok": True, "mode": mode})
        for name, mode in modes.items()
    }
    answers = {name: asking.Answer(reply, 2.0) for name, reply in said.items()}
    leader, robot, last = asking.words(OperatorRequest(do="release"), list(said), answers, 3.0).splitlines()
    assert (leader.split()[:2], robot.split()[:2]) == (["leader", "run"], ["robot1", "released"])
    assert last == "release: 2 of 2 obey, slowest 2 ms"


def test_what_is_over_is_not_asked_again() -> None:
    fleet = Fleet([reply("robot1")], [reply("robot2")])
    answers = asking.ask(fleet.ask, ["robot1", "robot2"], STOP, 10.0, over=lambda: len(fleet.keys) == 1)
    assert (set(answers), len(fleet.keys)) == ({"robot1"}, 1)


@pytest.mark.parametrize(
    ("do", "asked"),
    [(do, SIX.names) for do in ("stop", "release")] + [(do, ("robot1",)) for do in ("hold", "run", "shape")],
)
def test_a_stop_is_told_to_each_robot_and_what_travels_with_the_positions_to_the_leader(
    do: Do, asked: tuple[str, ...]
) -> None:
    assert asking.addressed(SIX, do) == asked


def test_each_request_has_an_id_of_its_own_and_a_shape_is_one_of_the_missions() -> None:
    assert len({asking.request_for(SIX, "stop").id for _ in range(10)}) == 10
    assert asking.request_for(SIX, "shape", "wedge").shape == "wedge"
    for shape in (None, "circle", ""):
        with pytest.raises(ValueError, match="must be one of hexagon, wedge"):
            asking.request_for(SIX, "shape", shape)
    with pytest.raises(ValueError, match="'fly': must be one of hold, run, stop, release, shape"):
        asking.request_for(SIX, "fly")
    with pytest.raises(ValueError, match="hold: takes no shape"):
        asking.request_for(SIX, "hold", "wedge")


def test_what_the_answers_come_to_names_the_shape_and_who_is_missing() -> None:
    request = OperatorRequest(do="shape", shape="wedge")
    said = {"robot1": asking.Answer(OperatorReply(robot="robot1", ok=True, mode="run"), 2.0)}
    assert asking.summary(request, ["robot1"], said) == "shape wedge: 1 of 1 obey, slowest 2 ms"
    assert asking.report(request, ["robot1"], said)["shape"] == "wedge"
    assert asking.summary(STOP, ["robot1"], {}) == "stop: 0 of 1 obey; no answer from robot1"


def test_an_order_that_sets_robots_going_says_how_old_it_is_and_a_stop_is_never_too_old() -> None:
    for do, ages in (("release", True), ("run", True), ("stop", False), ("hold", False)):
        heard: list[OperatorRequest] = []

        def put(
            _key: str, payload: bytes, _timeout: float, heard: list[OperatorRequest] = heard
        ) -> list[Reply]:
            heard.append(order.decode(OperatorRequest, payload))
            return []

        asking.ask(put, ["robot1"], asking.request_for(SIX, do), 0.2)
        assert heard[0].age == 0.0
        assert (heard[-1].age > 0.1) == ages
        assert [one.age for one in heard] == sorted(one.age for one in heard)


def test_what_a_robot_says_cannot_steer_the_terminal_that_shows_it() -> None:
    said = OperatorReply(robot="robot1", ok=False, mode="stop", reason="\x1b[2J\x1b]0;all obey\x07no\n")
    rude = Reply("robot1/order", order.encode(said), 2.0)
    answers = asking.ask(Fleet([rude]).ask, ["robot1"], STOP, 10.0)
    first, *_ = asking.words(STOP, ["robot1"], answers, 1.0).splitlines()
    assert "REFUSED" in first
    assert first.isprintable()
