"""The leader as a real process over real Zenoh."""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Sequence

import pytest

from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.protocol.request import OperatorReply
from formation.ros2.messages import Diagnostics, Pose, decode
from formation.wire import Sample
from tests.processes.agent.leader_and_robot import first_received, leader, listening, received
from tests.support.child import PATIENCE, free_endpoint

pytestmark = pytest.mark.processes


def order_of(sample: Sample) -> Order:
    reported = json_message.decode(PositionAttachment, sample.attachment or b"").order
    assert reported is not None
    return reported


def any_newer_than(moment: float) -> Callable[[Sequence[Sample]], bool]:
    """Return whether one of some positions is newer than `moment` [s, system clock]."""
    return lambda samples: any(decode(Pose, sample.payload).stamp > moment for sample in samples)


@pytest.mark.smoke
def test_leader_follows_route_in_real_time_and_sends_hold_last() -> None:
    end = free_endpoint()
    with leader(end) as child, listening(end, "robot1/position", "robot1/status") as bus:
        first_received(bus)
        samples = received(bus, lambda samples: len(positions(samples)) >= 30)
        assert child.signal(signal.SIGINT) < 5.0
        assert child.wait() == 0
        summary = child.event("summary")
        ending = received(bus, lambda samples: any(b"SIGINT" in sample.payload for sample in samples))
    poses = [decode(Pose, sample.payload) for sample in positions(samples)]
    orders = [order_of(sample) for sample in positions(samples)]
    way = poses[-1].position - poses[0].position
    assert abs(way) / (poses[-1].stamp - poses[0].stamp) == pytest.approx(0.2, abs=1e-3)
    assert math.degrees(math.atan2(way.imag, way.real)) == pytest.approx(30.0, abs=1e-3)
    beats = [one.beat for one in orders]
    assert beats == sorted(set(beats))  # one may get lost: positions are not sent again
    assert {(one.mode, one.shape) for one in orders} == {("run", "hexagon")}
    last = order_of(positions(ending)[-1])
    assert (last.mode, last.beat) == ("hold", summary["published"]["robot1/position"])
    assert decode(Diagnostics, ending[-1].payload).statuses[0].values["reason.cause"] == "SIGINT"
    assert (summary["process"], summary["dropped"]) == ("leader robot1", {"overflowed": 0})
    assert "SIGINT" in child.errors


def positions(samples: Sequence[Sample]) -> list[Sample]:
    return [sample for sample in samples if sample.key == "robot1/position"]


@pytest.mark.smoke
def test_leader_obeys_valid_requests_and_refuses_others() -> None:
    end = free_endpoint()
    with leader(end), listening(end, "robot1/position") as bus:
        first_received(bus)
        modes = []
        requests = (
            b'{"do":"stop","id":"s"}',
            b'{"do":"run"}',
            b'{"do":"release","ends":["other"]}',
            b'{"do":"release","id":"r","ends":["s"]}',
            b"nonsense",
            b'{"do":"run","ends":["r"]}',
        )
        for request in requests:
            (reply,) = bus.ask("robot1/order", request, timeout=PATIENCE)
            answer = json_message.decode(OperatorReply, reply.payload)
            # the reply may overtake earlier positions, which have a lower priority
            after = received(bus, any_newer_than(time.time()))
            modes.append((answer.ok, answer.mode, order_of(after[-1]).mode))
    assert modes == [
        (True, "stop", "stop"),
        (False, "stop", "stop"),
        (False, "stop", "stop"),
        (True, "hold", "hold"),
        (False, "hold", "hold"),
        (True, "run", "run"),
    ]
