"""The trace attached to each command for the fleet: all inputs of the agent; it never blocks a command."""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest

from formation.agent.core import Agent
from formation.agent.persistence import trace
from formation.agent.persistence.state import dump, restore
from formation.agent.persistence.trace import (
    MAX_TRACE_BYTES,
    MAX_TRACED_INPUTS,
    STATE_PERIOD,
    BadTraceError,
    Link,
    RequestStep,
    Step,
    Trace,
    checksum,
    read,
)
from formation.mission.file import load
from formation.protocol.attachment import PositionAttachment
from formation.protocol.json_message import encode as encode_order
from formation.protocol.order import Order
from formation.protocol.request import MAX_REQUEST_BYTES
from formation.protocol.status import AgentState
from formation.ros2.messages import MAX_PAYLOAD_BYTES, Odometry, Pose, Text, decode, encode
from formation.topics import CMD_VEL, ODOM, POSITION
from formation.wire import Sample
from tests.support.fleet import at
from tests.support.missions import with_robots
from tests.support.recorded import Looped, RecordedFleet, Recording

SIX = load("six_robots")
KEY = CMD_VEL.key("robot3")
HELD = [ODOM.key("robot3"), *(POSITION.key(f"robot{other}") for other in (1, 2))]


def odometry(mono: float, attachment: bytes | None = None) -> Sample:
    payload = encode(Odometry(1.7e9 + mono, 0.1 * mono + 0j, 1 + 0j, 0.1, 0.0))
    return Sample(ODOM.key("robot3"), payload, attachment, mono)


def position(mono: float, count: int, robot: str = "robot1") -> Sample:
    result = Order(term=1, beat=count, mode="run", shape="hexagon")
    reported = PositionAttachment(publisher_id="v", count=count, order=result, mission=SIX.tag)
    payload = encode(Pose(1.7e9 + mono, 1 + 0.1 * mono + 0j, 1 + 0j))
    return Sample(POSITION.key(robot), payload, encode_order(reported), mono)


class Setting:
    """One agent in its loop, with a recording."""

    def __init__(self, *, readonly: bool = False) -> None:
        self.agent = Agent(SIX, "robot3", publisher_id="abc", readonly=readonly)
        self.record: Recording = []
        self.loop = Looped(self.agent, self.record)

    def turn(self, mono: float, *inbox: Sample) -> Any:
        """Run one step; return the trace of its command, None without command or trace."""
        self.record.clear()
        self.loop.step(at(mono), inbox)
        return self.trace()

    def trace(self) -> Any:
        return json.loads(self.attachment) if self.attachment else None

    @property
    def attachment(self) -> bytes:
        """The attachment of the newest command; empty if there is none."""
        return next((sample.attachment or b"" for sample, _ in self.record if sample.key == KEY), b"")


@pytest.fixture
def setting() -> Setting:
    """A setting after the first command."""
    setting = Setting()
    setting.turn(1.0)
    return setting


def test_command_trace_carries_all_steps_since_last_command() -> None:
    setting = Setting()
    assert setting.turn(1.0)["n"] == 1  # at rest, because there is no input yet
    assert setting.turn(1.01, position(1.009, 1)) is None
    assert setting.turn(1.02) is None
    seen = odometry(1.029)
    result = setting.turn(1.03, seen)
    assert result == {
        "n": 2,
        "publisher_id": "abc",
        "steps": [
            [1.01, 1.7e9 + 1.01, [[1, checksum(position(1.009, 1)), 1.009]]],
            [1.02, 1.7e9 + 1.02, []],
            [1.03, 1.7e9 + 1.03, [[0, checksum(seen), 1.029]]],
        ],
    }


def test_first_trace_describes_agent_and_its_state() -> None:
    setting = Setting(readonly=True)
    result = setting.turn(1.0)
    assert result["agent"] == {"law": "field", "readonly": True, "mission": SIX.fingerprint, "keys": HELD}
    assert result["state"] == dump(setting.agent)


def test_state_is_traced_every_state_period(setting: Setting) -> None:
    moment, reported = 1.0, []
    for _ in range(450):
        moment += 0.05
        result = setting.turn(moment, odometry(moment))
        if "state" in result:
            reported.append(moment)
            other = Agent(SIX, "robot3", publisher_id="abc")
            restore(other, result["state"])
            assert dump(other) == dump(setting.agent)
    assert [after - before for before, after in pairwise(reported)] == pytest.approx(
        [STATE_PERIOD] * 3, abs=0.06
    )


def test_checksum_ignores_odometry_attachment_but_not_position_attachment() -> None:
    assert checksum(odometry(1.0)) == checksum(odometry(1.0, b"ROS's own"))
    assert checksum(position(1.0, 1)) != checksum(position(1.0, 2))


def test_link_to_robot_is_traced_when_it_changes() -> None:
    setting = Setting()
    assert setting.turn(1.0)["steps"] == [[1.0, 1.7e9 + 1.0, [], [True, True, False]]]
    assert setting.turn(1.1)["steps"] == [[1.1, 1.7e9 + 1.1, []]]
    setting.loop.robot.connected = False
    setting.turn(1.2)
    assert setting.turn(1.3)["steps"] == [[1.3, 1.7e9 + 1.3, [], [False, None, False]]]


def test_operator_requests_are_traced_and_invalid_ones_skipped(setting: Setting) -> None:
    for request in (b'{"do":"stop"}', b"\xff\xfe", b"x" * (MAX_REQUEST_BYTES + 1)):
        setting.loop.sides.request(request, 1.05)
    assert setting.turn(1.1)["steps"] == [[1.05, '{"do":"stop"}'], [1.1, 1.7e9 + 1.1, []]]


@pytest.mark.parametrize("size", [1025, 2001, MAX_REQUEST_BYTES])
def test_longest_obeyed_request_is_traced_and_read(setting: Setting, size: int) -> None:
    stop = b'{"do":"stop"}'.ljust(size)
    setting.loop.sides.request(stop, 1.05)
    assert setting.turn(1.1)["steps"][0] == [1.05, stop.decode()]
    assert setting.agent.decision.state is AgentState.STOP
    reported = read(setting.attachment)
    assert reported.steps[0] == RequestStep(1.05, stop.decode())


def test_too_many_long_requests_become_a_gap(setting: Setting) -> None:
    for _ in range(4):
        setting.loop.sides.request(b'{"do":"stop"}'.ljust(MAX_REQUEST_BYTES), 1.05)
    result = setting.turn(2.1)
    assert f"at most {MAX_TRACE_BYTES} are recorded" in result["gap"]
    assert result["state"]["latch"]["rest"]["stop"]


def test_halt_command_carries_a_trace(setting: Setting) -> None:
    setting.record.clear()
    setting.loop.halt(at(1.2), "SIGTERM")
    assert setting.trace() == {"n": 2, "publisher_id": "abc", "steps": [], "halt": [1.2, 1.7e9 + 1.2]}


def test_command_reaches_robot_before_trace_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    setting = Setting()
    at_the_robot = list[list[str]]()
    original = Trace.attachment

    def made(self: Trace) -> bytes | None:
        at_the_robot.append([out.key for out in setting.loop.robot.said])
        return original(self)

    monkeypatch.setattr(Trace, "attachment", made)
    setting.turn(1.0, odometry(1.0))
    assert [KEY in keys for keys in at_the_robot] == [True]


def test_flood_becomes_gap_and_next_trace_has_steps(setting: Setting) -> None:
    flood = [position(1.1, number) for number in range(MAX_TRACED_INPUTS + 1)]
    result = setting.turn(2.2, *flood)
    assert "steps" not in result
    assert "messages between two commands" in result["gap"]
    assert result["state"] == dump(setting.agent)
    assert setting.turn(2.3)["steps"] == [[2.3, 1.7e9 + 2.3, [], [True, True, False]]]


@pytest.mark.slow
def test_endless_flood_traces_state_once_per_second() -> None:
    setting = Setting()
    traced = 0
    for tick in range(80):
        moment = 1.0 + 0.06 * tick
        flood = [position(moment, number) for number in range(MAX_TRACED_INPUTS + 1)]
        traced += "state" in setting.turn(moment, *flood)
    assert traced == 5


def test_stored_steps_without_command_are_bounded() -> None:
    one = Trace(Agent(SIX, "robot3"))
    for tick in range(10_000):
        one.stepped(at(0.01 * tick), Link(True, True), [position(0.01 * tick, tick)])
        one.requested(b'{"do":"hold"}', 0.01 * tick)
        assert len(one._steps) <= MAX_TRACED_INPUTS
    result = one.attachment()
    assert result is not None
    assert "gap" in json.loads(result)


def test_oversized_message_becomes_gap(setting: Setting) -> None:
    result = setting.turn(1.1, Sample(POSITION.key("robot1"), b"x" * (MAX_PAYLOAD_BYTES + 1), None, 1.1))
    assert "longer than any that is read" in result["gap"]
    assert "gap" not in setting.turn(1.2)


def test_trace_of_many_requests_fits_into_ros_string(setting: Setting) -> None:
    """A std_msgs/String has to be printable and of limited length."""
    for _ in range(64):
        setting.loop.sides.request(('{"do":"' + "ä\t\x7f\u2028" * 250).encode()[:1024], 1.0)
    setting.record.clear()
    setting.loop.step(at(1.1), [])
    assert len(setting.attachment) <= MAX_TRACE_BYTES
    text = setting.attachment.decode("ascii")
    assert "at most" in json.loads(text)["gap"]
    assert text.isprintable()
    assert decode(Text, encode(Text(text))).text == text


def test_oversized_state_is_omitted_while_steps_are_traced(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(trace, "MAX_TRACE_BYTES", 800)
    setting = Setting()
    with caplog.at_level(logging.WARNING):
        result = setting.turn(1.0)
        setting.turn(7.0)
    assert result["steps"]
    assert result["agent"]
    assert "state" not in result
    assert len(caplog.messages) == 1
    assert "cannot be verified everywhere" in caplog.text


@pytest.mark.parametrize("fails", ["checksum", "dump", "_encode"])
def test_failing_trace_blocks_no_command_and_logs_once(
    fails: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sound, broken = Setting(), Setting()

    def fail(*_: Any) -> Any:
        raise RuntimeError("something nobody thought of")

    def commands(setting: Setting, moments: Sequence[float]) -> list[bytes]:
        result = []
        for moment in moments:
            setting.turn(moment, position(moment, int(100 * moment)), odometry(moment))
            result += [out.payload for out, _ in setting.record if out.key == KEY]
        return result

    first, then = [1.0, 1.05, 1.1], [2.2, 2.25]
    expected = commands(sound, first), commands(sound, then)
    with caplog.at_level(logging.WARNING):
        with monkeypatch.context() as patched:
            patched.setattr(trace, fails, fail)
            assert commands(broken, first) == expected[0]
        assert commands(broken, then) == expected[1]
    assert [message.count("something nobody thought of") for message in caplog.messages] == [1]
    reported = read(broken.attachment)
    assert reported.n == 5
    assert reported.gap == ""


def test_read_returns_traced_values_exactly() -> None:
    fleet = RecordedFleet(with_robots("turtlebot3_pair", localisation="external")).after(6.0)
    traces = [s.attachment for s, _ in fleet.record if s.key.endswith(CMD_VEL.name) and s.attachment]
    assert len(traces) > 100
    for attachment in traces:
        result, reported = json.loads(attachment), read(attachment)
        assert reported.state == result.get("state")
        for step, one in zip(result["steps"], reported.steps, strict=True):
            assert isinstance(one, Step)
            assert [one.mono, one.wall, [list(received[:3]) for received in one.received]] == step[:3]


@pytest.mark.parametrize(
    "attachment",
    [
        b"", b"\xff", b"[]", b"{}",
        b'{"n": -1, "publisher_id": ""}',
        b'{"n": 1, "publisher_id": "", "steps": [[1.0]]}',
        b'{"n": 1, "publisher_id": "", "steps": [[NaN, 1.0, []]]}',
        b'{"n": 1, "publisher_id": "", "halt": [1.0]}',
        b'{"n": 1, "publisher_id": "", "steps": [[1.0, 1.0, [[0, 1.5, 1.0]]]]}',
        b'{"n": 1, "publisher_id": "", "x": 1}',
        b'{"n": 1e999, "publisher_id": ""}', b"[" * 60_000,
        b'{"n": 1, "publisher_id": "", "state": ' + b"[" * 60_000,
    ],
)  # fmt: skip
def test_invalid_trace_is_refused_in_one_line(attachment: bytes) -> None:
    with pytest.raises(BadTraceError) as refused:
        read(attachment)
    assert "\n" not in str(refused.value)
