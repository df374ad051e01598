"""Invalid messages neither crash an agent nor move its robot."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from formation.agent.core import Agent
from formation.control import laws
from formation.control.laws import LAWS
from formation.control.unicycle import Command, advance
from formation.mission.file import load
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.protocol.reasons import Code
from formation.protocol.request import OperatorReply
from formation.protocol.status import AgentState
from formation.ros2.messages import Diagnostics, Odometry, Pose, Twist, decode, encode
from formation.topics import CMD_VEL, ODOM, POSITION, STATUS
from formation.wire import Now, Outgoing, Sample
from tests.support.fleet import EPOCH, at
from tests.support.mutations import mutated
from tests.unit.formation.scenarios import build

SIX = load("six_robots")
PERIOD = 0.05
ME, NEIGHBOURS = "robot3", ("robot1", "robot2")


def moment(step: int) -> Now:
    return at(step * PERIOD)


def between(step: int) -> Now:
    return at((step + 0.5) * PERIOD)


def relayed(step: int, shape: str = "hexagon") -> bytes:
    """The position attachment of a neighbour."""
    what = Order(term=1, beat=step, mode="run", shape=shape)
    return json_message.encode(PositionAttachment(publisher_id="v", count=step, order=what, mission=SIX.tag))


def inbox(step: int, me: Odometry | None = None, attachment: bytes | None = None) -> list[Sample]:
    """Messages of a healthy team in one period."""
    mono, wall = moment(step)
    way, attached = 0.2 * mono, relayed(step) if attachment is None else attachment
    samples = [
        Sample(POSITION.key(name), encode(Pose(wall, way + index * 1j, 1 + 0j)), attached, mono)
        for index, name in enumerate(NEIGHBOURS)
    ]
    me = me or Odometry(wall, way - 2, 1 + 0j, 0.2, 0.0)
    return [*samples, Sample(ODOM.key(ME), encode(me), None, mono)]


def under_way() -> Agent:
    """An agent after four periods in a healthy team."""
    agent = Agent(SIX, ME)
    for step in range(4):
        agent.step(moment(step), inbox(step))
    return agent


def test_robot_holds_as_long_as_law_is_not_finite(monkeypatch: pytest.MonkeyPatch) -> None:
    good = LAWS["field"]
    broken = [False]

    def step(*values: Any) -> tuple[Command, complex]:
        return (Command(math.nan, 0.0), 0j) if broken[0] else good.step(*values)

    monkeypatch.setattr(laws, "LAWS", {**LAWS, "field": good._replace(step=step)})
    agent = under_way()
    assert agent.decision.state is AgentState.RUN
    broken[0] = True
    for count in range(4, 12):
        sent = [*commands(agent.step(moment(count), inbox(count))), *commands(agent.step(between(count), []))]
        assert {(one.speed, one.turn_rate) for one in sent} <= {(0.0, 0.0)}
        assert agent.decision.reason.code is Code.COMMAND_NOT_FINITE
    broken[0] = False
    for count in range(12, 14):
        agent.step(moment(count), inbox(count))
    assert agent.decision.state is AgentState.RUN
    assert agent.command.speed != 0.0


def commands(outbox: list[Outgoing]) -> list[Twist]:
    return [decode(Twist, out.payload) for out in outbox if out.key == CMD_VEL.key(ME)]


def hostile(step: int, count: int, dice: random.Random) -> Iterator[Sample]:
    """Mutations of valid messages, on keys to which the agent subscribes and on others."""
    honest = inbox(step)
    payloads = [sample.payload for sample in honest]
    attachments = [sample.attachment for sample in honest if sample.attachment]
    for _ in range(count):
        like = dice.choice(honest)
        key = dice.choice([like.key, like.key, dice.choice(honest).key, "robot9/position", "", "a/b/c"])
        attachment = like.attachment if dice.random() < 0.5 else mutated(dice, attachments)
        yield Sample(key, mutated(dice, payloads), attachment, like.arrived)


def is_harmless(sample: Sample) -> bool:
    """Whether the mutation is an invalid message for its key, as most are."""
    try:
        decode(Odometry if sample.key == ODOM.key(ME) else Pose, sample.payload)
    except ValueError:
        return True
    return sample.key not in {ODOM.key(ME), *(POSITION.key(name) for name in NEIGHBOURS)}


def test_mutated_messages_crash_nothing_and_change_no_command() -> None:
    dice = random.Random(20)
    spared, attacked = Agent(SIX, ME), Agent(SIX, ME)
    sent, position, heading = 0, -2.0 + 0.0j, 1.0 + 0.0j
    for step in range(500):
        me = Odometry(moment(step)[1], position, heading, *spared.command)
        clean = inbox(step, me)
        dirty = [bad for bad in hostile(step, 60, dice) if is_harmless(bad)]
        sent += len(dirty)
        expected = commands(spared.step(moment(step), clean))
        among_the_honest = [*dirty[:20], *clean[:2], *dirty[20:], clean[2]]
        assert commands(attacked.step(moment(step), among_the_honest)) == expected
        position, heading = advance(position, heading, *spared.command, 0.05)
    assert sent >= 20_000
    assert spared.decision.state is AgentState.RUN
    assert sum(attacked.dropped.values()) >= sent


def test_mutated_messages_neither_crash_nor_exceed_limits() -> None:
    dice = random.Random(21)
    agent, limits = Agent(SIX, ME), SIX.robots[ME]
    for step in range(500):
        out = agent.step(moment(step), [*hostile(step, 40, dice), *inbox(step)])
        for command in commands(out):
            assert abs(command.speed) <= limits.max_speed
            assert abs(command.turn_rate) <= limits.max_turn_rate


def test_dropped_messages_are_counted_and_listed_in_status() -> None:
    agent = Agent(SIX, ME)
    agent.step(moment(0), [Sample(POSITION.key("robot1"), b"\0\1\0\0cut", None, 0.0)])
    agent.step(moment(1), [Sample("robot9/position", b"", None, 0.05)])
    out = agent.step(moment(20), inbox(20))
    (status,) = [o for o in out if o.key == STATUS.key(ME)]
    assert agent.dropped == {POSITION.key("robot1"): 1, "elsewhere": 1}
    assert b"dropped.robot1/position" in status.payload
    assert b"geometry_msgs/msg/PoseStamped" in status.payload


def test_status_lists_dropped_messages_of_a_hundred_neighbours() -> None:
    followers = 100
    slots = np.linspace(0, -followers - 1, followers + 2, dtype=np.complex128)
    mission = build(slots, [(), *[(0,)] * followers, range(followers + 1)])
    name = mission.followers[-1]
    agent = Agent(mission, name)
    position = encode(Pose(EPOCH, 0j, 1 + 0j))
    stranger = json_message.encode(PositionAttachment(publisher_id="v", count=1, mission=mission.tag))
    stranger = stranger.replace(b"}", b', "' + b"x" * 900 + b'": 1}')
    for other in mission.robots[name].neighbours:
        agent.step(at(0.0), [Sample(POSITION.key(other), position, stranger, 0.0)])
    (status,) = [out for out in agent.step(at(1.0), []) if out.key == STATUS.key(name)]
    values = decode(Diagnostics, status.payload).statuses[0].values
    assert sum(key.startswith("dropped.") for key in values) == len(mission.robots[name].neighbours)


@pytest.mark.parametrize(
    "attachment",
    [
        b"",
        b"{}",
        b"[" * 900,
        b'{"publisher_id": "v", "count": -1}',
        b'{"publisher_id": "v v", "count": 9}',
        b'{"publisher_id": "v", "count": 9, "more": 1}',
        b'{"publisher_id":"v", "count":9, "order":{"term":1, "beat":99, "mode":"fly", "shape":"hexagon"}}',
    ],
)
def test_position_with_invalid_attachment_is_dropped(attachment: bytes) -> None:
    agent = under_way()
    agent.step(moment(4), inbox(4, attachment=attachment))
    assert agent.dropped == {POSITION.key(name): 1 for name in NEIGHBOURS}
    assert agent.neighbours.each["robot1"].stream.state.arrived == moment(3).mono


def test_order_with_unknown_shape_is_dropped_but_position_used() -> None:
    agent = under_way()
    agent.step(moment(4), inbox(4, attachment=relayed(4, "banana")))
    assert agent.dropped == {POSITION.key(name): 1 for name in NEIGHBOURS}
    assert agent.decision.state is AgentState.RUN
    assert agent.neighbours.each["robot1"].stream.state.arrived == moment(4).mono


@pytest.mark.parametrize("request_bytes", [b"", b"stop", b"{}", b'{"do": "explode"}', b"\xff" * 4000])
def test_invalid_request_is_answered_with_reason(request_bytes: bytes) -> None:
    agent = Agent(SIX, ME)
    reply = json_message.decode(OperatorReply, agent.request(request_bytes, 0.5))
    assert not reply.ok
    assert reply.reason
    assert commands(agent.step(moment(1), [])) == [Twist(0.0, 0.0)]
    assert agent.decision.state is AgentState.WAITING


def test_agent_refuses_leader_and_unknown_law() -> None:
    with pytest.raises(ValueError, match="robot 'robot1': must be a follower"):
        Agent(SIX, "robot1")
    with pytest.raises(ValueError, match="law 'magic': must be one of field, paper"):
        Agent(SIX, ME, "magic")
