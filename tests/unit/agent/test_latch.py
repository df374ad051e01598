"""Operator requests to one robot, sent once or repeatedly."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.agent.safety.latch import HALTED, Latch
from formation.leader.plan import TeamMode
from formation.protocol import reasons
from formation.protocol.json_message import decode
from formation.protocol.request import UNREACHED, Do, OperatorReply, OperatorRequest, ReplyCode
from formation.protocol.stops import MAX_REMEMBERED_REQUESTS, TRAVEL_TIME, Rest
from tests.campaigns.timings.orders import SCENARIOS

GO: dict[Do, Do] = {"stop": "release", "hold": "run"}
"""The request that ends each."""
every_rest = pytest.mark.parametrize("rest", GO)
Scenario = Callable[[random.Random], None]


@pytest.fixture
def latch() -> Latch:
    return Latch("robot1")


def named(do: Do, rest: Rest) -> tuple[str, ...]:
    """Ids that a request names: for a release or a run, all that are in force."""
    return tuple(filter(None, (rest.stop, rest.hold))) if do in {"release", "run"} else ()


def ask(
    latch: Latch,
    do: Do,
    of: str = "",
    received: float = 0.0,
    age: float = 0.0,
    ends: tuple[str, ...] | None = None,
) -> OperatorReply:
    """Send a request; a release or a run names all ids in force, or `ends`."""
    ends = named(do, latch.state.rest) if ends is None else ends
    request = OperatorRequest(do=do, id=of, age=age, ends=ends)
    return decode(OperatorReply, latch.request(request, received, "run"))


def test_repeated_release_does_not_end_later_stop(latch: Latch) -> None:
    ask(latch, "stop", "a")
    first = ask(latch, "release", "b")
    assert ask(latch, "stop", "c").mode == latch.mode == "stop"
    assert ask(latch, "release", "b", ends=("a",)) == first
    assert latch.mode == "stop"
    assert ask(latch, "release", "d").mode == "hold"


def test_release_leaves_hold_until_run(latch: Latch) -> None:
    ask(latch, "hold", "h")
    ask(latch, "stop", "s")
    assert ask(latch, "run").code == "stopped"
    assert ask(latch, "release", "r").mode == "hold"
    again = ask(latch, "release", "r2", ends=("s",))
    assert (again.ok, again.code, latch.mode) == (True, "nothing", "hold")
    late = ask(latch, "run", "x", ends=("h", "s"))  # requested before the release
    assert (late.ok, late.code, latch.mode) == (False, "another", "hold")
    assert ask(latch, "run", "y", ends=("r",)).mode == "run"
    assert latch.mode is None


@every_rest
def test_release_and_run_must_name_ids_they_end(latch: Latch, rest: Do) -> None:
    ask(latch, rest, rest)
    replies = [ask(latch, GO[rest], of, ends=ends) for of, ends in (("u", ()), ("a", ("older",)))]
    assert [(one.ok, one.code) for one in replies] == [(False, "unnamed"), (False, "another")]
    assert latch.mode == rest


def test_query_returns_ids_and_changes_nothing(latch: Latch) -> None:
    ask(latch, "hold", "h")
    ask(latch, "stop", "s")
    reply = ask(latch, "query")
    assert (reply.ok, reply.mode, reply.stop, reply.hold, latch.mode) == (True, "stop", "s", "h", "stop")


@pytest.mark.parametrize("code", sorted(UNREACHED))
@every_rest
def test_stop_of_unreachable_robot_is_latched_but_not_ok(latch: Latch, rest: Do, code: ReplyCode) -> None:
    request = OperatorRequest(do=rest, id="s")
    reply = decode(OperatorReply, latch.request(request, 0.0, "run", code))
    assert (reply.ok, reply.code, latch.mode) == (False, code, rest)
    again = request.model_copy(update={"age": 0.1})
    assert decode(OperatorReply, latch.request(again, 0.1, "run")).ok, "the link works again"


@pytest.mark.parametrize("of", ["", "different every time"])
def test_requests_without_id_or_with_new_id_are_obeyed(latch: Latch, of: str) -> None:
    for number in range(MAX_REMEMBERED_REQUESTS + 2):
        of = of and f"{number}"
        ask(latch, "stop", of and f"{of}s")
        assert latch.mode == "stop"
        ask(latch, "release", of)
        ask(latch, "run", of)
        assert latch.state.rest.mode is None
    assert len(latch.state.once.answers) <= MAX_REMEMBERED_REQUESTS


@every_rest
def test_agent_refuses_shape_request_and_keeps_latch(latch: Latch, rest: Do) -> None:
    ask(latch, rest)
    reply = decode(OperatorReply, latch.request(OperatorRequest(do="shape", shape="line"), 0.0, "run"))
    assert (reply.ok, latch.mode, reply.mode) == (False, rest, rest)
    assert "leader" in reply.reason


@every_rest
def test_stop_with_id_of_earlier_release_is_obeyed(latch: Latch, rest: Do) -> None:
    assert ask(latch, "release", "1", received=10.0).mode == "run"
    assert ask(latch, rest, "1", received=20.0).mode == latch.mode == rest
    again = ask(latch, "release", "1", received=30.0, age=20.0)
    assert again.mode == "run", "the first answer is repeated"
    assert latch.mode == rest


@every_rest
def test_new_stop_with_reused_id_is_obeyed(latch: Latch, rest: Do) -> None:
    ask(latch, rest, "s", received=1.0)
    ask(latch, "release", "r", received=5.0)
    assert ask(latch, rest, "s", received=60.0).mode == latch.mode == rest
    assert ask(latch, GO[rest], "r2", received=61.0, ends=("s",)).code == "another"
    assert list(latch.state.once.answers) == ["release r", f"{rest} s", f"{GO[rest]} r2"]
    assert not ask(latch, GO[rest], "late", 61.0, age=2.0).ok, "it is older than the stop with the reused id"


@every_rest
def test_repeated_stop_or_hold_does_not_override_later_run(latch: Latch, rest: Do) -> None:
    modes = []
    for age in (0.0, 0.05, 0.1, 0.2):
        ask(latch, rest, "mine", 100.0 + age, age)
        modes.append(latch.mode)
        if age == 0.05:
            assert ask(latch, "release", "another", 100.06).ok
            assert ask(latch, "run", "another", 100.07).ok
    assert modes == [rest, rest, None, None]


@given(st.lists(st.sampled_from(["stop", "hold", "run", "release"]), max_size=8))
def test_latch_and_team_mode_give_same_answers(wishes: list[Do]) -> None:
    latch, team_mode = Latch("robot1"), TeamMode()
    for do in wishes:
        ok = team_mode.change(OperatorRequest(do=do, ends=named(do, team_mode.rest)), "fact").ok
        assert (ask(latch, do).ok, latch.mode or "run") == (ok, team_mode.mode)


@pytest.mark.parametrize(
    ("do", "known"), [("hold", True), ("run", True), ("stop", False), ("release", False)]
)
def test_reason_of_stop_at_start_remains_until_stop_or_release(latch: Latch, do: Do, known: bool) -> None:
    latch.state.rest.stop, latch.state.stop_reason = (
        "doubt",
        reasons.Reason(reasons.Code.STOPPED_BEFORE_START),
    )
    ask(latch, do)
    assert bool(latch.state.why) is known


def test_own_reason_of_a_hold_lasts_until_run(latch: Latch) -> None:
    state, own = latch.state, reasons.Reason.of(reasons.Code.AGENT_FAILS, detail="it failed")
    state.rest.hold, state.hold_reason = "own", own
    steps: list[tuple[Do, reasons.Reason | None]] = [("hold", own), ("stop", None), ("release", own)]
    for do, why in steps:
        assert ask(latch, do).ok
        assert state.why is why
    assert ask(latch, "run").ok
    assert state.why is state.hold_reason is None


def test_operator_may_not_use_the_id_of_an_ended_agent(latch: Latch) -> None:
    assert latch.request(OperatorRequest(do="stop", id=HALTED), 1.0, "run")
    assert latch.state.rest.stop not in {"", HALTED}


@every_rest
def test_release_or_run_older_than_stop_or_hold_is_refused(latch: Latch, rest: Do) -> None:
    go = GO[rest]
    ask(latch, rest, received=100.0)
    for received in (110.0, 200.0):  # the repetition is too late as well
        reply = ask(latch, go, "late", received, age=10.5)
        assert (reply.ok, latch.mode) == (False, rest)
        assert "before the newest stop" in reply.reason
    assert ask(latch, go).ok
    assert latch.mode != rest


@pytest.mark.parametrize(
    ("received", "age", "ok"),
    [
        (110.0, 9.9, True),
        (100.05, 0.04, True),  # its repetition arrives first
        (110.0, 10.0 - 0.8 * TRAVEL_TIME, False),
        (110.0, 10.0 - 1.2 * TRAVEL_TIME, True),
    ],
)
def test_late_release_counts_only_if_requested_after_stop(
    latch: Latch, received: float, age: float, ok: bool
) -> None:
    ask(latch, "stop", received=100.0)
    assert ask(latch, "release", "late", received, age).ok is ok
    assert latch.mode == ("hold" if ok else "stop")


def test_hold_with_earlier_time_keeps_time_of_stop(latch: Latch) -> None:
    ask(latch, "stop", received=99.9)  # while the process was frozen
    ask(latch, "hold", received=50.0)  # does not make the stop older
    assert not ask(latch, "release", "late", 100.0, age=5.0).ok
    assert latch.mode == "stop"
    assert ask(latch, "release", "c", 106.0, age=5.0).ok


@pytest.mark.slow
@pytest.mark.parametrize("part", range(3))
@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda one: one.__name__)
def test_scenarios_lose_no_stop_and_move_robots_only_by_run(scenario: Scenario, part: int) -> None:
    for seed in range(10 * part, 10 * part + 10):
        scenario(random.Random(f"{scenario.__name__} {seed}"))
