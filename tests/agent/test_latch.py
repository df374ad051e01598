"""What an operator asks of one robot, put once or again and again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.latch import Latch
from formation.once import REMEMBERED, TRAVEL
from formation.order import Do, OperatorReply, OperatorRequest, decode, encode
from formation.outcome import Asked
from formation.transport import asking
from formation.transport.question import Question
from leader.will import Will


def ask(latch: Latch, do: Do, of: str = "", heard: float = 0.0, age: float = 0.0) -> OperatorReply:
    request = OperatorRequest(do=do, id=of, age=age)
    return decode(OperatorReply, latch.ask(encode(request), heard, "run"))


def test_a_release_that_is_put_again_does_not_undo_a_stop_that_came_meanwhile() -> None:
    latch = Latch("robot1")
    ask(latch, "stop", "a")
    first = ask(latch, "release", "b")
    assert ask(latch, "stop", "c").mode == latch.mode == "stop"
    assert ask(latch, "release", "b") == first
    assert latch.mode == "stop"
    ask(latch, "release", "d")
    assert latch.mode is None


@pytest.mark.parametrize("of", ["", "different every time"])
def test_requests_without_a_name_or_with_another_one_are_each_obeyed(of: str) -> None:
    latch = Latch("robot1")
    for number in range(REMEMBERED + 2):
        of = of and f"{number}"
        ask(latch, "stop", of and f"{of}s")
        assert latch.mode == "stop"
        ask(latch, "release", of)
        assert latch.mode is None
    assert len(latch.once.answers) <= REMEMBERED


def test_a_shape_is_not_an_agents_to_change_and_releases_nothing() -> None:
    latch = Latch("robot1")
    rests: tuple[Do, ...] = ("hold", "stop")
    for do in rests:
        ask(latch, do)
        reply = decode(
            OperatorReply, latch.ask(encode(OperatorRequest(do="shape", shape="line")), 0.0, "run")
        )
        assert (reply.ok, latch.mode, reply.mode) == (False, do, do)
        assert "leader" in reply.reason


@pytest.mark.parametrize("rest", ["stop", "hold"])
def test_a_stop_with_the_id_of_an_earlier_release_is_obeyed(rest: Do) -> None:
    latch = Latch("robot1")
    assert ask(latch, "release", "1", heard=10.0).mode == "run"
    assert ask(latch, rest, "1", heard=20.0).mode == latch.mode == rest
    assert ask(latch, "release", "1", heard=30.0, age=20.0).mode == "run", "what was answered to it"
    assert latch.mode == rest


@pytest.mark.parametrize("rest", ["stop", "hold"])
def test_a_stop_that_is_asked_afresh_is_obeyed_though_its_id_was_used_before(rest: Do) -> None:
    latch = Latch("robot1")
    ask(latch, rest, "s", heard=1.0)
    ask(latch, "release", "r", heard=5.0)
    assert ask(latch, rest, "s", heard=60.0).mode == latch.mode == rest
    assert list(latch.once.answers) == ["release r", f"{rest} s"]
    assert not ask(latch, "release", "late", 61.0, age=2.0).ok, "it is as new as any other"


@pytest.mark.parametrize("rest", ["stop", "hold"])
def test_a_stop_that_goes_on_being_put_until_all_have_answered_does_not_outdo_a_release_of_somebody_else(
    rest: Do,
) -> None:
    latch, modes = Latch("robot1"), []

    def put(_key: str, payload: bytes, _: float) -> Question:
        latch.ask(payload, 100.0, "run")
        modes.append(latch.mode)
        if len(modes) == 2:
            assert ask(latch, "release", "another", 100.0).ok
        question = Question()  # nobody's answer comes through
        question.end()
        return question

    asking.ask(put, Asked(("robot1",)), OperatorRequest(do=rest, id="mine"), 9.0, lambda: len(modes) > 4)
    assert modes == [rest, rest, None, None, None]


@pytest.mark.parametrize("rests", [("hold", "stop"), ("stop", "hold")])
def test_a_hold_below_a_stop_outlives_the_stops_release(rests: tuple[Do, ...]) -> None:
    latch = Latch("robot1")
    assert all(ask(latch, do).ok for do in rests)
    told = [(reply.ok, reply.mode) for reply in (ask(latch, "run"), ask(latch, "release"))]
    assert told == [(False, "stop"), (True, "hold")]
    assert latch.mode == "hold"
    assert ask(latch, "release").mode == "run"
    assert latch.mode is None


@given(st.lists(st.sampled_from(["stop", "hold", "run", "release"]), max_size=8))
def test_a_robots_latch_answers_as_its_leaders_will_does(wishes: list[Do]) -> None:
    latch, will = Latch("robot1"), Will()
    for do in wishes:
        ok, _ = will.change(do)
        assert (ask(latch, do).ok, latch.mode or "run") == (ok, will.mode)


@pytest.mark.parametrize(
    ("do", "known"), [("hold", True), ("run", True), ("stop", False), ("release", False)]
)
def test_why_it_came_up_stopped_is_said_until_that_is_released_or_asked_for_anew(do: Do, known: bool) -> None:
    latch = Latch("robot1")
    latch.stopped, latch.why = True, "its file cannot be read"
    ask(latch, do)
    assert bool(latch.why) is known


@pytest.mark.parametrize("rest", ["stop", "hold"])
def test_a_release_that_was_asked_for_before_a_stop_and_is_heard_after_it_lets_nobody_go(rest: Do) -> None:
    latch = Latch("robot1")
    ask(latch, rest, heard=100.0)
    for heard in (110.0, 200.0):  # it is put again, and goes on being too late
        reply = ask(latch, "release", "late", heard, age=10.5)
        assert (reply.ok, latch.mode) == (False, rest)
        assert "before the newest stop" in reply.reason
    assert ask(latch, "release").ok
    assert latch.mode is None


def test_a_release_that_was_asked_for_after_the_stop_counts_however_late_it_is_heard() -> None:
    latch = Latch("robot1")
    ask(latch, "stop", heard=100.0)
    assert ask(latch, "release", "late", 110.0, age=9.9).ok
    assert latch.mode is None


def test_a_script_that_releases_right_after_its_stop_is_obeyed_by_who_hears_only_its_second_question() -> (
    None
):
    latch = Latch("robot1")
    ask(latch, "stop", heard=100.0)
    assert ask(latch, "release", "next", 100.05, age=0.04).ok
    assert latch.mode is None


def test_a_release_so_close_after_the_stop_that_nobody_knows_which_was_first_lets_nobody_go() -> None:
    latch = Latch("robot1")
    ask(latch, "stop", heard=100.0)
    for age, ok in ((10.0 - 0.8 * TRAVEL, False), (10.0 - 1.2 * TRAVEL, True)):
        assert ask(latch, "release", f"at{age:g}", 110.0, age).ok is ok


def test_a_stop_that_came_first_counts_from_then_though_it_is_answered_with_another_after_a_pause() -> None:
    latch = Latch("robot1")
    ask(latch, "stop", heard=99.9)  # while its process hung
    ask(latch, "hold", heard=50.0)  # and the stop is no older for that
    assert not ask(latch, "release", "late", 100.0, age=5.0).ok
    assert latch.mode == "stop"
    assert ask(latch, "release", "c", 106.0, age=5.0).ok
