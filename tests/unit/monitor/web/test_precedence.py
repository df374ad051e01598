"""Orders from several pages and repeated clicks: which ones are given, and which are still sent."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.mission.route import Straight
from formation.monitor.web.control import (
    DOUBLE_CLICK_TIME,
    MAX_SHOWN_AGE,
    UNSEEN_STOP_TIME,
    GivenOrder,
    Overruled,
    Precedence,
)
from formation.protocol.request import OperatorRequest
from formation.protocol.stops import RESTS

LATER = max(DOUBLE_CLICK_TIME, UNSEEN_STOP_TIME) + 0.1


FIELDS: dict[str, dict[str, Any]] = {
    "shape": {"shape": "wedge"},
    "rotate": {"degrees": -30.0},
    "scale": {"factor": 1.5},
    "speed": {"speed": 0.1, "degrees": 90.0},
    "route": {"legs": (Straight(speed=0.1, heading_deg=0.0),)},
}
"""Fields that an order needs."""
STARTING = ["run", "release", *FIELDS]
"""Orders that may start robots."""


def request(do: Any) -> OperatorRequest:
    return OperatorRequest(do=do, **FIELDS.get(do, {}))


def give(orders: Precedence, do: str, now: float, **how: Any) -> GivenOrder:
    return orders.accept(request(do), now, **how)[0]


def finished(one: GivenOrder) -> GivenOrder:
    one.sending = False
    return one


def is_sent(one: GivenOrder) -> bool:
    return one.sending and not one.overruled


@pytest.mark.parametrize("do", STARTING)
def test_double_click_gives_one_order(do: str) -> None:
    orders = Precedence()
    first, new = orders.accept(request(do), 0.0)
    assert new
    assert orders.accept(request(do), 0.3) == (first, False)
    finished(first)
    assert orders.accept(request(do), DOUBLE_CLICK_TIME) == (first, False)
    assert orders.accept(request(do), DOUBLE_CLICK_TIME + 0.1)[1]


def test_request_repeated_after_another_is_new() -> None:
    orders = Precedence()
    first = give(orders, "run", 0.0)
    give(orders, "shape", 0.2)
    again = give(orders, "run", 0.4)
    assert again is not first


@pytest.mark.parametrize(
    ("do", "name", "values"),
    [("rotate", "degrees", (10.0, 20.0, 10.0)), ("shape", "shape", ("wedge", "hexagon", "wedge"))],
)
def test_changed_value_is_new_request_repetition_is_not(do: str, name: str, values: tuple[Any, ...]) -> None:
    orders = Precedence()
    for number, value in enumerate(values):
        request = OperatorRequest.model_validate({"do": do, name: value, "id": f"{number}"})
        given, new = orders.accept(request, 0.1 * number)
        assert new
        again = request.model_copy(update={"id": "another", "age": 0.5})
        assert orders.accept(again, 0.1 * number + 0.05) == (given, False)


@pytest.mark.parametrize("rest", sorted(RESTS))
def test_every_repeated_stop_or_hold_is_given(rest: str) -> None:
    orders = Precedence()
    rests = [orders.accept(request(rest), 0.1 * number, click="same") for number in range(5)]
    assert all(new for _, new in rests)
    assert not rests[-1][0].overruled


def test_repeated_click_takes_effect_once() -> None:
    orders = Precedence()
    first = give(orders, "release", 0.0, click="a")
    finished(first)
    finished(give(orders, "stop", 20.0, click="b"))
    assert orders.accept(request("release"), 60.0, click="a") == (first, False)
    assert orders.accept(request("release"), 60.0, click="c")[1]


def test_same_click_with_other_request_is_new() -> None:
    orders = Precedence()
    give(orders, "run", 0.0, click="a")
    assert orders.accept(request("hold"), 10.0, click="a")[1]
    assert orders.accept(request("stop"), 20.0, click="a")[1]


@pytest.mark.parametrize("rest", sorted(RESTS))
@pytest.mark.parametrize("do", STARTING)
def test_motion_is_refused_while_stop_or_hold_is_unanswered(do: str, rest: str) -> None:
    orders = Precedence()
    given = give(orders, rest, 0.0)
    with pytest.raises(Overruled, match=f"{do}: a {rest} is being given, and not every robot has answered"):
        give(orders, do, LATER)
    assert is_sent(given)
    finished(given)
    assert not give(orders, do, LATER).overruled


@pytest.mark.parametrize("rest", sorted(RESTS))
@pytest.mark.parametrize("do", STARTING)
def test_motion_is_refused_just_after_late_answer(rest: str, do: str) -> None:
    orders = Precedence()
    orders.end(give(orders, rest, 0.0), 3.0)
    with pytest.raises(Overruled, match="just now"):
        give(orders, do, 3.0 + 0.5 * UNSEEN_STOP_TIME)
    with pytest.raises(Overruled, match="just now"):
        give(orders, do, 3.5 + UNSEEN_STOP_TIME, behind=1.0)
    assert not give(orders, do, 3.5 + UNSEEN_STOP_TIME).overruled


@pytest.mark.parametrize("rest", sorted(RESTS))
@pytest.mark.parametrize("do", STARTING)
def test_motion_is_refused_just_after_stop_or_hold(rest: str, do: str) -> None:
    orders = Precedence()
    finished(give(orders, rest, 5.0))
    with pytest.raises(Overruled, match="just now"):
        give(orders, do, 5.0 + 0.9 * UNSEEN_STOP_TIME)
    assert not give(orders, do, 5.0 + 1.1 * UNSEEN_STOP_TIME).overruled


def test_release_from_page_older_than_stop_is_refused() -> None:
    orders = Precedence()
    finished(give(orders, "stop", 5.0))
    with pytest.raises(Overruled, match="just now"):
        give(orders, "release", 7.5, behind=2.0)
    assert not give(orders, "release", 7.5, behind=0.1).overruled


def test_outdated_page_may_only_stop_and_hold() -> None:
    orders = Precedence()
    for do in STARTING:
        for behind, ago in ((12.0, "12 s ago"), (1.7e9, "long ago")):
            with pytest.raises(Overruled, match=f"shows what was {ago}"):
                give(orders, do, 100.0, behind=behind)
    for do in ("hold", "stop"):
        assert not give(orders, do, 101.0, behind=12.0).overruled


def test_close_ends_sending() -> None:
    orders = Precedence()
    one = give(orders, "hold", 0.0)
    orders.close()
    assert one.overruled


requests = st.tuples(
    st.sampled_from(["stop", "hold", *STARTING]),
    st.floats(0.0, 2.0),  # time since the request before [s]
    st.booleans(),  # whether all requests before are answered
    st.sampled_from(["", "", "a", "b"]),
    st.none() | st.floats(0.0, 2 * MAX_SHOWN_AGE),
)


@given(st.lists(requests, max_size=30))
def test_stop_is_always_sent_and_overrules_older_requests(
    clicks: list[tuple[str, float, bool, str, float | None]],
) -> None:
    orders, now, rested = Precedence(), 0.0, -100.0
    requested: list[GivenOrder] = []
    for do, wait, answered, click, behind in clicks:
        now += wait
        for one in requested if answered else []:
            finished(one)
        resting = any(is_sent(one) and one.request.do in RESTS for one in requested)
        try:
            one, new = orders.accept(request(do), now, click=click, behind=behind)
        except Overruled:
            assert do not in RESTS
            continue
        if not new:
            assert one in requested
            assert (one.request.do, do) != ("stop", "stop")
            continue
        if do in RESTS:
            rested = now
        else:
            assert not resting
            assert now - rested >= UNSEEN_STOP_TIME
            assert behind is None or behind <= MAX_SHOWN_AGE
        requested.append(one)
        put = [other for other in requested if is_sent(other)]
        assert put[-1] is one
        assert all(other.request.do == "stop" for other in put[:-1])
