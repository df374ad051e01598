"""Orders, requests and replies on the wire, and the outcome of a request."""

from __future__ import annotations

import json
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.protocol.json_message import MAX_ORDER_BYTES, decode, encode
from formation.protocol.order import Order, newer
from formation.protocol.outcome import Answer, Outcome, Recipients, called
from formation.protocol.request import MAX_REASON_CHARS, UNREACHED, OperatorReply, OperatorRequest, shortened
from formation.wire import BadMessage
from tests.support.mutations import mutated

ORDER = Order(term=1_763_687_000_000_000_000, beat=17, mode="run", shape="hexagon")
FIELDS = json.loads(encode(ORDER))
counts = st.integers(0, 2**63 - 1)
shapes = st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True)
orders = st.builds(
    Order, term=counts, beat=counts, mode=st.sampled_from(["hold", "run", "stop"]), shape=shapes
)


@given(orders)
def test_decode_inverts_encode_for_orders(order: Order) -> None:
    data = encode(order)
    assert len(data) <= MAX_ORDER_BYTES
    assert decode(Order, data) == order


@given(orders, orders)
def test_newer_compares_term_then_beat(a: Order, b: Order) -> None:
    for other in (b, b.model_copy(update={"term": a.term})):
        assert newer(a, other) == ((a.term, a.beat) > (other.term, other.beat))
    assert not newer(a, a)
    assert newer(a, None)


def test_encoded_stop_request_has_only_do_and_id() -> None:
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


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("term", value) for value in (-1, 2**63, 1.0, "1", None)),
        ("beat", True),
        *(("mode", value) for value in ("go", 1)),
        *(("shape", value) for value in ("", "a" * 65, "../etc", "line\n")),
        ("speed", 1),
    ],
)
def test_refusal_names_wrong_field_of_order(name: str, value: object) -> None:
    with pytest.raises(BadMessage, match=f"^Order: {name}: "):
        decode(Order, json.dumps(FIELDS | {name: value}).encode())


@pytest.mark.parametrize("missing", ["term", "beat", "mode", "shape"])
def test_refusal_names_missing_field_of_order(missing: str) -> None:
    rest = json.dumps({name: value for name, value in FIELDS.items() if name != missing})
    with pytest.raises(BadMessage, match=f"^Order: {missing}: "):
        decode(Order, rest.encode())


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
def test_payload_that_is_no_order_is_refused(data: bytes) -> None:
    with pytest.raises(BadMessage, match=r"^Order: "):
        decode(Order, data)


@pytest.mark.parametrize(
    ("cls", "data", "reason"),
    [
        (OperatorRequest, b'{"do":"shape"}', r"OperatorRequest: \w+ takes "),
        (OperatorRequest, b'{"do":"stop","shape":"line"}', r"OperatorRequest: \w+ takes "),
        (OperatorRequest, b'{"do": "fly"}', r"do: Input should be 'hold', 'run', 'stop'"),
        (Order, encode(ORDER) + b" " * MAX_ORDER_BYTES, f"at most {MAX_ORDER_BYTES}"),
    ],
    ids=["no shape", "shape", "fly", "long"],
)
def test_refusal_names_illegal_request_or_length(cls: Any, data: bytes, reason: str) -> None:
    with pytest.raises(BadMessage, match=reason):
        decode(cls, data)


@pytest.mark.parametrize("cls", [Order, OperatorRequest, OperatorReply])
def test_mutated_orders_are_refused_or_decoded_consistently(cls: Any) -> None:
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


STOP = OperatorRequest(do="stop", id="1a")
RUN = OperatorRequest(do="run")
ALL = Recipients(("leader", "spare"), ("robot1", "robot2"))


def answer(robot: str, **result: Any) -> Answer:
    return Answer(OperatorReply.model_validate({"robot": robot, "ok": True, "mode": "stop", **result}), 2.0)


def outcome(request: OperatorRequest, recipients: Recipients, *answers: Answer) -> Outcome:
    return Outcome(request, recipients, {one.reply.robot: one for one in answers}, 1e9, 3.0)


ROBOTS = (answer("robot1"), answer("robot2"))
LEADS, LED = answer("leader", leads=True), answer("spare", leads=True)
SPARE = answer("spare", leads=False)
REFUSED = answer("leader", ok=False, reason="release it first", leads=True)


def test_request_is_obeyed_when_robots_and_leader_obey() -> None:
    assert outcome(STOP, ALL, *ROBOTS, LEADS).obeyed
    assert outcome(STOP, ALL, *ROBOTS, LEADS, SPARE).obeyed
    assert not outcome(STOP, ALL, ROBOTS[0], LEADS).obeyed
    assert outcome(RUN, Recipients(("leader",)), answer("leader")).leader == "leader"  # no standbys


def test_dead_leader_is_not_missing_if_standby_leads() -> None:
    one = outcome(STOP, ALL, *ROBOTS, LED)
    assert (one.obeyed, one.leader, one.missing) == (True, "spare", [])
    assert "leader      no answer; spare leads" in one.words()


@pytest.mark.parametrize("others", [(), (SPARE,)])
def test_summary_of_stop_reports_missing_leader(others: tuple[Answer, ...]) -> None:
    one = outcome(STOP, ALL, *ROBOTS, *others)
    assert (one.obeyed, one.leader, one.missing) == (False, None, ["leader"])
    assert one.summary().startswith("stop: 2 of 3 obey, slowest 2 ms; no answer from leader")
    assert one.summary().endswith("robots that obey stand, with a leader or without")


def test_outcome_prints_reason_of_refusal() -> None:
    one = outcome(RUN, Recipients(("leader",)), REFUSED)
    assert (one.obeyed, one.missing, one.refused) == (False, [], ["leader"])
    assert all(words in one.words() for words in ("REFUSED", "release it first", "run: 0 of 1 obey"))


def test_outcome_table_aligns_columns_with_long_names() -> None:
    long = "a-robot-of-a-very-long-name"
    one = outcome(RUN, Recipients(("leader",), (long, "robot2")), REFUSED, answer(long), ROBOTS[1])
    leader, other, short, _ = one.words().splitlines()
    assert f"  {long}  obeys " in other
    assert leader.index("REFUSED") == other.index("obeys") == short.index("obeys")


def test_standby_counts_neither_as_obeying_nor_refusing() -> None:
    one = outcome(RUN, Recipients(("leader", "spare")), LEADS, answer("spare", ok=False, leads=False))
    assert (one.obeyed, one.refused, one.standby) == (True, [], ["spare"])
    assert one.summary() == "run: 1 of 1 obey, slowest 2 ms"
    assert "spare       stands by" in one.words()


def test_release_prints_that_robots_hold_until_run() -> None:
    request = OperatorRequest(do="release", ends=("s",))
    one = outcome(request, Recipients(("leader",), ("robot1",)), answer("leader", mode="hold"), ROBOTS[0])
    leader, robot, last = one.words().splitlines()
    assert (leader.split()[:2], robot.split()[:2]) == (["leader", "released"], ["robot1", "released"])
    assert last == "release: 2 of 2 obey, slowest 2 ms; all robots hold until you order run"
    assert one.report()["ends"] == ["s"]


def test_release_summary_names_robots_without_stop_or_answer() -> None:
    leader, robot = (answer(name, code="nothing", mode="hold") for name in ("leader", "robot1"))
    one = outcome(OperatorRequest(do="release"), ALL, leader, robot)
    assert one.refused == []
    assert one.summary().endswith(
        "; nothing to release at leader, robot1; robot2 may still be stopped: release again"
    )


def test_incomplete_run_reports_possibly_held_robot() -> None:
    one = outcome(RUN, ALL, LEADS, ROBOTS[0])
    assert not one.obeyed
    assert one.summary().endswith("no answer from robot2; robot2 may still be held: order run again")


def test_run_while_stopped_says_what_to_order() -> None:
    refuses = answer("robot1", ok=False, code="stopped", reason="stopped: release it first")
    one = outcome(RUN, ALL, LEADS, refuses, ROBOTS[1])
    assert one.report()["advice"] == ["a stop is in force at robot1: order release, then run"]


def test_robot_that_obeys_run_is_not_shown_as_held() -> None:
    one = outcome(RUN, ALL, answer("leader", mode="run", leads=True), answer("robot1", mode="hold"))
    leader, _, robot, *_ = one.words().splitlines()
    assert (leader.split()[:2], robot.split()[:2]) == (["leader", "run"], ["robot1", "obeys"])


@pytest.mark.parametrize(("do", "verdict"), [("stop", "NOT STOPPED"), ("hold", "NOT HELD")])
@pytest.mark.parametrize("code", sorted(UNREACHED))
def test_outcome_names_unreached_robot_and_what_to_do(do: str, verdict: str, code: str) -> None:
    lost = answer("robot1", ok=False, code=code, reason="latched, but no link")
    request = OperatorRequest.model_validate({"do": do})
    one = outcome(request, ALL, LEADS, lost, ROBOTS[1])
    assert (one.obeyed, one.unreached, one.missing) == (False, ["robot1"], [])
    assert f"{verdict}: robot1: use the robot's own switch" in one.summary()
    assert f"  robot1      {verdict}" in one.words()
    (refused,) = one.report()["refused"]
    assert (refused["code"], one.report()["unreached"]) == (code, ["robot1"])


def test_report_lists_acknowledged_refused_and_missing_robots() -> None:
    refuses = answer("robot1", ok=False, reason="no")
    assert outcome(STOP, ALL, LEADS, SPARE, refuses).report() == {
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
def test_called_gives_request_as_typed(what: dict[str, Any], result: str) -> None:
    assert called(OperatorRequest.model_validate(what)) == result
