"""What an operator asks of one robot, put once or again and again."""

from __future__ import annotations

import pytest

from agent.latch import Latch
from formation.order import REMEMBERED, Do, Mode, OperatorReply, OperatorRequest, decode, encode


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
    assert len(latch._once._answers) <= REMEMBERED


def test_a_shape_is_not_an_agents_to_change_and_releases_nothing() -> None:
    latch = Latch("robot1")
    modes: tuple[Mode, ...] = ("stop", "hold")
    for do in modes:
        latch.mode = do
        reply = decode(OperatorReply, latch.ask(encode(OperatorRequest(do="shape", shape="line")), "run"))
        assert (reply.ok, latch.mode, reply.mode) == (False, do, do)
        assert "leader" in reply.reason
