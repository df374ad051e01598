"""What an operator asks of one robot, put once or again and again."""

from __future__ import annotations

import pytest

from agent.latch import Latch
from formation.once import REMEMBERED, STEPS
from formation.order import Do, Mode, OperatorReply, OperatorRequest, decode, encode
from formation.wire import Now


def ask(latch: Latch, do: Do, of: str = "") -> OperatorReply:
    return decode(OperatorReply, latch.ask(encode(OperatorRequest(do=do, id=of)), "run"))


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
    modes: tuple[Mode, ...] = ("stop", "hold")
    for do in modes:
        latch.mode = do
        reply = decode(OperatorReply, latch.ask(encode(OperatorRequest(do="shape", shape="line")), "run"))
        assert (reply.ok, latch.mode, reply.mode) == (False, do, do)
        assert "leader" in reply.reason


@pytest.mark.parametrize("rest", ["stop", "hold"])
def test_a_release_that_was_asked_for_before_a_stop_and_is_heard_after_it_lets_nobody_go(rest: Do) -> None:
    latch = Latch("robot1")
    latch.aware(Now(100.0, 0.0))
    ask(latch, rest)
    latch.aware(Now(110.0, 0.0))
    late = OperatorRequest(do="release", id="late", age=10.5)
    for _ in range(2):  # it is put again, and goes on being too late
        reply = decode(OperatorReply, latch.ask(encode(late), "run"))
        assert (reply.ok, latch.mode) == (False, rest)
        assert "before the newest stop" in reply.reason
        latch.aware(Now(200.0, 0.0))
    assert ask(latch, "release").ok
    assert latch.mode is None


def test_a_release_that_was_asked_for_after_the_stop_counts_however_late_it_is_heard() -> None:
    latch = Latch("robot1")
    latch.aware(Now(100.0, 0.0))
    ask(latch, "stop")
    latch.aware(Now(100.2, 0.0))
    latch.aware(Now(110.0, 0.0))
    late = OperatorRequest(do="release", id="late", age=9.5)
    assert decode(OperatorReply, latch.ask(encode(late), "run")).ok
    assert latch.mode is None


def test_a_release_so_close_after_the_stop_that_nobody_knows_which_was_first_lets_nobody_go() -> None:
    latch = Latch("robot1")
    latch.aware(Now(100.0, 0.0))
    ask(latch, "stop")
    latch.aware(Now(100.1, 0.0))
    latch.aware(Now(110.0, 0.0))
    for age, ok in ((9.9 - 0.8 * STEPS, False), (9.9 - 1.2 * STEPS, True)):
        late = OperatorRequest(do="release", id=f"at{age:g}", age=age)
        assert decode(OperatorReply, latch.ask(encode(late), "run")).ok is ok


@pytest.mark.parametrize("steps", [(), (0.0, 50.0)])
def test_a_stop_heard_before_the_first_step_or_after_a_long_one_is_no_older_than_it_may_be(
    steps: tuple[float, ...],
) -> None:
    latch = Latch("robot1")
    for mono in steps:
        latch.aware(Now(mono, 0.0))
    ask(latch, "stop")  # at 99.9: the agent has just begun, or hung
    late = OperatorRequest(do="release", id="late", age=5.0)  # put at 97, when nobody was to be stopped
    assert not decode(OperatorReply, latch.ask(encode(late), "run")).ok
    for mono in (100.0, 102.0):
        latch.aware(Now(mono, 0.0))
    assert not decode(OperatorReply, latch.ask(encode(late.model_copy(update={"id": "b"})), "run")).ok
    assert latch.mode == "stop"
    latch.aware(Now(106.0, 0.0))
    assert decode(OperatorReply, latch.ask(encode(late.model_copy(update={"id": "c"})), "run")).ok
