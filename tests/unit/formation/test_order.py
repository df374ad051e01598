from __future__ import annotations

import json
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from formation.protocol.order import (
    MAX_ORDER_BYTES,
    MAX_REASON_CHARS,
    OperatorReply,
    OperatorRequest,
    Order,
    decode,
    encode,
    newer,
    shortened,
)
from formation.wire import BadMessage
from tests.support.mutations import mutated

ORDER = Order(term=1_763_687_000_000_000_000, beat=17, mode="run", shape="hexagon")
FIELDS = json.loads(encode(ORDER))
counts = st.integers(0, 2**63 - 1)
shapes = st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True)
orders = st.builds(
    Order,
    term=counts,
    beat=counts,
    mode=st.sampled_from(["hold", "run", "stop"]),
    shape=shapes,
)


@given(orders)
def test_an_order_comes_back_as_it_was_sent(order: Order) -> None:
    data = encode(order)
    assert len(data) <= MAX_ORDER_BYTES
    assert decode(Order, data) == order


@pytest.mark.parametrize("do", ["hold", "run", "stop", "release"])
def test_a_request_comes_back_as_it_was_sent(do: Any) -> None:
    assert decode(OperatorRequest, encode(OperatorRequest(do=do))).do == do


@given(shapes)
def test_a_shape_comes_back_as_it_was_asked_for(shape: str) -> None:
    data = encode(OperatorRequest(do="shape", shape=shape, id="i" * 64))
    assert len(data) <= MAX_ORDER_BYTES
    assert decode(OperatorRequest, data).shape == shape


@pytest.mark.parametrize("data", [b'{"do":"shape"}', b'{"do":"stop","shape":"line"}'])
def test_a_shape_belongs_to_the_order_of_that_name(data: bytes) -> None:
    with pytest.raises(BadMessage, match=r"OperatorRequest: \w+ takes "):
        decode(OperatorRequest, data)


def test_stop_request_has_no_fields_of_newer_versions() -> None:
    assert json.loads(encode(OperatorRequest(do="stop", id="a"))) == {"do": "stop", "id": "a"}


@pytest.mark.parametrize("sign", ["a", "\x00", "é", "\U0001f916", '"'])
def test_longest_reply_fits_and_is_marked_as_shortened(sign: str) -> None:
    result = shortened(sign * 5000)
    assert result.endswith(f"{sign}…")
    reply = OperatorReply(robot="r" * 64, ok=False, mode="stop", reason=result, leads=False)
    assert decode(OperatorReply, encode(reply)) == reply
    assert MAX_ORDER_BYTES // 2 < len(encode(reply)) <= MAX_ORDER_BYTES


def test_reason_within_limit_is_unchanged() -> None:
    assert shortened("") == ""
    assert shortened("a" * MAX_REASON_CHARS) == "a" * MAX_REASON_CHARS
    assert shortened("a" * MAX_REASON_CHARS + "b") == "a" * (MAX_REASON_CHARS - 1) + "…"


def test_an_order_is_a_value() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        ORDER.mode = "stop"


def test_a_later_beat_or_a_later_term_supersedes() -> None:
    next_beat = ORDER.model_copy(update={"beat": 18})
    next_term = ORDER.model_copy(update={"term": ORDER.term + 1, "beat": 0})
    assert newer(ORDER, None)
    assert newer(next_beat, ORDER)
    assert newer(next_term, next_beat)
    assert not newer(next_beat, next_term)


@given(orders, orders)
def test_of_two_orders_at_most_one_supersedes(a: Order, b: Order) -> None:
    same_rank = (a.term, a.beat) == (b.term, b.beat)
    assert newer(a, b) + newer(b, a) == (0 if same_rank else 1)


def test_a_replayed_order_does_not_supersede_itself() -> None:
    assert not newer(ORDER, ORDER)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"term": -1}, "term"),
        ({"term": 2**63}, "term"),
        ({"term": 1.0}, "term"),
        ({"term": "1"}, "term"),
        ({"term": None}, "term"),
        ({"beat": True}, "beat"),
        ({"mode": "go"}, "mode"),
        ({"mode": 1}, "mode"),
        ({"shape": ""}, "shape"),
        ({"shape": "a" * 65}, "shape"),
        ({"shape": "../etc"}, "shape"),
        ({"shape": "line\n"}, "shape"),
        ({"speed": 1}, "speed"),
    ],
)
def test_an_order_with_a_wrong_field_is_refused_by_name(change: dict[str, Any], named: str) -> None:
    with pytest.raises(BadMessage, match=f"^Order: {named}: "):
        decode(Order, json.dumps(FIELDS | change).encode())


@pytest.mark.parametrize("missing", ["term", "beat", "mode", "shape"])
def test_an_order_without_a_field_is_refused_by_name(missing: str) -> None:
    rest = {name: value for name, value in FIELDS.items() if name != missing}
    with pytest.raises(BadMessage, match=f"^Order: {missing}: "):
        decode(Order, json.dumps(rest).encode())


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"{",
        b"null",
        b"[]",
        b'"run"',
        b"\xff\xfe",
        b"{}" * 2,
        b"[" * 1000,
        b'{"a":' * 200,
        b"NaN",
        b"1e999",
    ],
)
def test_what_is_no_order_at_all_is_refused(data: bytes) -> None:
    with pytest.raises(BadMessage, match=r"^Order: "):
        decode(Order, data)


def test_an_order_beyond_the_size_limit_is_refused_unread() -> None:
    with pytest.raises(BadMessage, match=f"at most {MAX_ORDER_BYTES}"):
        decode(Order, encode(ORDER) + b" " * MAX_ORDER_BYTES)


def test_a_request_for_something_else_names_what_is_legal() -> None:
    with pytest.raises(BadMessage, match=r"do: Input should be 'hold', 'run', 'stop'"):
        decode(OperatorRequest, b'{"do": "fly"}')


@pytest.mark.parametrize("cls", [Order, OperatorRequest, OperatorReply])
def test_mutated_orders_are_read_strictly_or_refused(cls: Any) -> None:
    corpus = [
        encode(ORDER),
        encode(OperatorRequest(do="stop")),
        encode(OperatorRequest(do="shape", shape="line")),
        encode(OperatorReply(robot="robot2", ok=True, mode="stop", reason="operator")),
    ]
    rng = random.Random(f"fuzz {cls.__name__}")
    accepted = refused = 0
    for _ in range(4000):
        data = mutated(rng, corpus)
        try:
            value = decode(cls, data)
        except BadMessage:
            refused += 1
        else:
            accepted += 1
            assert decode(cls, encode(value)) == value
    assert accepted > 50
    assert refused > 2000
