"""Statuses as typed values: encoding, decoding of damaged statuses, and sentences."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from formation.control.zones import Zone
from formation.protocol import reasons, status_codec
from formation.protocol.reasons import MAX_NUMBER, SENTENCES, Code, Reason
from formation.protocol.request import OperatorRequest
from formation.protocol.status import (
    AgentState,
    AgentStatus,
    AnsweredRequest,
    AnyStatus,
    CollisionMode,
    LeaderState,
    LeaderStatus,
    Localised,
    MotionFault,
    RobotLink,
    Sight,
    WatchdogState,
    WatchdogStatus,
)
from formation.ros2.messages import Diagnostics, Status, encode
from formation.wire import BadMessage

KINDS: tuple[type[AnyStatus], ...] = (AgentStatus, LeaderStatus, WatchdogStatus)
words = st.text(st.sampled_from("ab1_.-/: ;{}é"), min_size=1, max_size=12).map(str.strip).filter(bool)
robots = st.text(st.sampled_from("abc019_.-"), min_size=1, max_size=8)
numbers = st.floats(-MAX_NUMBER, MAX_NUMBER)
counts = st.integers(0, 2**63 - 1)
names = st.lists(robots, max_size=3).map(tuple)
reals, tallies = (st.dictionaries(robots, one, max_size=3) for one in (numbers, counts))
texts = st.dictionaries(robots, words, max_size=3)
VALUES = {"number": numbers, "text": words, "names": names, "each": reals}
why = st.sampled_from(Code).flatmap(
    lambda code: st.builds(
        Reason,
        st.just(code),
        st.fixed_dictionaries({name: VALUES[kind] for name, kind in reasons.fields(code)}),
    )
)
requested = st.lists(
    st.builds(
        AnsweredRequest,
        st.builds(OperatorRequest, do=st.sampled_from(["stop", "hold"]), id=robots),
        st.booleans(),
        words,
    ),
    max_size=3,
).map(tuple)
FIELDS: dict[str, Any] = {
    "Text": words,
    "Real": numbers,
    "Real | None": st.none() | numbers,
    "Count": counts,
    "bool": st.booleans(),
    "Names": names,
    "Reals": reals,
    "Counts": tallies,
    "Texts": texts,
    "Why": why,
    "Why | None": st.none() | why,
    "Zone | None": st.none() | st.sampled_from(Zone),
    "AgentState": st.sampled_from(AgentState),
    "LeaderState": st.sampled_from(LeaderState),
    "LeaderState | None": st.none() | st.sampled_from(LeaderState),
    "WatchdogState": st.sampled_from(WatchdogState),
    "RobotLink": st.sampled_from(RobotLink),
    "MotionFault | None": st.none() | st.sampled_from(MotionFault),
    "CollisionMode | None": st.none() | st.sampled_from(CollisionMode),
    "Sight | None": st.none() | st.sampled_from(Sight),
    "Localised": st.sampled_from(Localised),
}


def of_type(name: str) -> Any:
    if "AnsweredRequest" in name:
        return requested
    return FIELDS.get(name, st.dictionaries(robots, st.sampled_from(["ahead", "earlier"])))


def of_kind(kind: type[AnyStatus]) -> Any:
    return st.builds(kind, **{one.name: of_type(str(one.type)) for one in dataclasses.fields(kind)})


statuses = st.sampled_from(KINDS).flatmap(of_kind)
RUNS = AgentStatus(robot="robot1", state=AgentState.RUN, reason=Reason(Code.RUNNING))


@given(statuses)
def test_status_is_unchanged_by_encoding_and_reading(status: AnyStatus) -> None:
    payload = encode(status_codec.to_message(status, 1e9))
    assert status_codec.read(type(status), payload) == status
    assert status_codec.sentence(status)
    assert status_codec.from_message(AgentStatus, Diagnostics(1e9, ())) is None


@given(st.sampled_from(WatchdogState), robots)
def test_status_is_unchanged_by_json_reply(state: WatchdogState, robot: str) -> None:
    status = WatchdogStatus(robot=robot, state=state)
    assert status_codec.from_json(WatchdogStatus, status_codec.to_json(status)) == status


@given(statuses, st.dictionaries(words, words))
def test_unknown_keys_are_ignored(status: AnyStatus, more: dict[str, str]) -> None:
    sent = status_codec.encode(status)
    known = {one.name for one in dataclasses.fields(status)} | {status_codec.KIND}
    strange = {key: value for key, value in more.items() if key.partition(".")[0] not in known}
    read = status_codec.decode(type(status), dataclasses.replace(sent, values={**sent.values, **strange}))
    assert read == status


@given(st.sampled_from(KINDS), st.data())
def test_damaged_status_raises_only_bad_message(kind: type[AnyStatus], data: st.DataObject) -> None:
    drawn: AnyStatus = data.draw(of_kind(kind))
    sent = dict(status_codec.encode(drawn).values)
    keys = [*sent, *(f"{one.name}.x" for one in dataclasses.fields(kind)), "reason.silent.x", "reason.silent"]
    text = st.sampled_from(["", "nan", "inf", "1e400", "-1", "[", "[" * 5000, "{}", "9" * 5000]) | st.text()
    for key in data.draw(st.lists(st.sampled_from(keys), max_size=4)):
        sent[key] = data.draw(text)
    for key in data.draw(st.lists(st.sampled_from(keys), max_size=2)):
        sent.pop(key, None)
    with contextlib.suppress(BadMessage):
        status_codec.decode(kind, Status("", 0, "", "", sent))


@given(st.binary(max_size=200) | st.text().map(str.encode))
def test_random_reply_raises_bad_message(data: bytes) -> None:
    with pytest.raises(BadMessage):
        status_codec.from_json(WatchdogStatus, data)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("kind", "leader"), ("state", "dancing"), ("reason", "because"), ("speed", "nan"), ("speed", "1e13"),
        ("age.robot2", "inf"), ("deadlocks", "-1"), ("zone", "red"), ("law", "x" * 401), ("follows.x", "y"),
    ],
)  # fmt: skip
def test_status_with_illegal_value_is_refused(key: str, value: str) -> None:
    sent = status_codec.encode(RUNS)
    with pytest.raises(BadMessage, match="status: "):
        status_codec.decode(AgentStatus, dataclasses.replace(sent, values={**sent.values, key: value}))


@pytest.mark.parametrize(
    ("age", "sent"), [(math.inf, MAX_NUMBER), (-math.inf, -MAX_NUMBER), (math.nan, MAX_NUMBER)]
)
def test_published_numbers_are_finite(age: float, sent: float) -> None:
    status = status_codec.encode(dataclasses.replace(RUNS, age={"robot2": age}))
    assert status_codec.decode(AgentStatus, status).age == {"robot2": sent}
    assert Reason.of(Code.SCAN_SILENT, age=age, limit=1.0).values == {"age": sent, "limit": 1.0}


@given(why)
def test_sentence_names_every_value(reason: Reason) -> None:
    assert set(SENTENCES) == set(Code)
    for value in reason.values.values():
        parts = value if isinstance(value, tuple | dict) else [value] if isinstance(value, str) else []
        assert all(part in str(reason) for part in parts)


def test_sentence_leaves_out_clauses_of_empty_lists() -> None:
    lost = Reason.of(
        Code.NO_NEIGHBOUR, silent={"robot2": 0.4}, never_received=(), unavailable=(), outside=("r3",)
    )
    assert str(lost) == "no neighbour can be followed; silent: robot2 0.40 s; outside the bounds: r3"


@pytest.mark.parametrize("values", [{}, {"age": "x"}, {"age": math.nan}, {"age": 1.0, "source": "pose"}])
def test_reason_with_missing_or_wrong_values_is_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"age|limit|source"):
        Reason.read("position_silent", values)
