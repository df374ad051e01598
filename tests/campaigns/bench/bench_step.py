"""What one `Agent.step` costs with everything in the caches, and what the codec's share of it is.

python -m tests.campaigns.bench.bench_step [--rounds N] [--json]

Here steps follow each other at once, as they never do on a robot: at 50 Hz each finds the caches cold
(`bench_agent` has those figures).
"""

from __future__ import annotations

import statistics
import time
from typing import Any

from formation.agent.core import Agent
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.protocol.status import AgentState
from formation.ros2.messages import Odometry, Pose, Twist, decode, encode
from formation.topics import ODOM, POSITION
from formation.wire import Now, Sample
from tests.campaigns.bench import edge
from tests.campaigns.bench.bench_law import microseconds
from tests.campaigns.figures import command, markdown, over_rounds, span

STEPS = 2000
EPOCH = 1.7e9
"""[s]"""


def steps(mission: Mission) -> dict[str, float]:
    """Medians of steps that a neighbour's position, and that odometry brought about [µs]."""
    agent, robot = Agent(mission, edge.FOLLOWER), edge.Follower()
    by_position, by_odometry = [], []
    for beat in range(STEPS):
        elapsed = beat / edge.RATE
        now = Now(elapsed, EPOCH + elapsed)
        attachment = json_message.encode(edge.attachment("bench", beat, mission.tag))
        for name in (edge.LEADER, edge.NEIGHBOUR):
            payload = encode(edge.position(name, elapsed, now.wall))
            by_position.append(stopped(agent, now, Sample(POSITION.key(name), payload, attachment, now.mono)))
        payload = encode(robot.odometry(agent.command, 1.0 / edge.RATE, now.wall))
        by_odometry.append(stopped(agent, now, Sample(ODOM.key(edge.FOLLOWER), payload, None, now.mono)))
    assert agent.decision.state is AgentState.RUN, agent.decision
    return {
        "Agent.step, a neighbour's position": statistics.median(by_position),
        "Agent.step, odometry": statistics.median(by_odometry),
    }


def stopped(agent: Agent, now: Now, sample: Sample) -> float:
    """Time of one step [µs]."""
    inbox = [sample]
    start = time.perf_counter()
    agent.step(now, inbox)
    return 1e6 * (time.perf_counter() - start)


def codec() -> dict[str, float]:
    """Time of each message that passes in a step [µs]."""
    odometry, pose = edge.odometry(0.0, EPOCH), edge.position(edge.LEADER, 0.0, EPOCH)
    beat, command = Order(term=time.time_ns(), beat=1000, mode="run", shape="line"), Twist(0.2, 0.1)
    decoded = PositionAttachment(publisher_id="bench", count=1000, order=beat, mission="0123abcd")
    received, seen, relayed = encode(odometry), encode(pose), json_message.encode(decoded)
    return {
        "decode Odometry": microseconds(lambda: decode(Odometry, received)),
        "decode PoseStamped": microseconds(lambda: decode(Pose, seen)),
        "decode the order on it": microseconds(lambda: json_message.decode(PositionAttachment, relayed)),
        "encode Twist": microseconds(lambda: encode(command)),
        "encode PoseStamped": microseconds(lambda: encode(pose)),
        "encode the order on it": microseconds(lambda: json_message.encode(decoded)),
    }


def measure(rounds: int) -> Any:
    """All figures [µs]."""
    mission = parse(edge.mission())
    return over_rounds([{**steps(mission), **codec()} for _ in range(rounds)])


def section(found: Any) -> str:
    """The figures in Markdown."""
    rows = [(name, span(took, 1)) for name, took in found.items()]
    return markdown(("back to back, two neighbours", "µs"), rows)


if __name__ == "__main__":
    command(__doc__, measure, section)
