"""The command lines of everybody in the scene: the agent, its two yardsticks, and their surroundings."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from formation.agent.core import Agent
from formation.mission.file import load
from formation.protocol.order import Order, PositionAttachment
from formation.protocol.order import encode as encode_order
from formation.ros2.messages import encode
from formation.ros2.ros_names import address
from formation.topics import ALIVE, CMD_VEL, ODOM, POSITION, STATUS, Topic
from formation.transport.bus import BusConfig
from formation.transport.session import settings_of
from formation.wire import Now, Outgoing, Sample
from tests.campaigns.bench import edge
from tests.support.child import free_endpoint

ROBOTS = {"agent": edge.FOLLOWER, "copy": "copy", "echo": "echo"}
"""In whose name each subject speaks."""


class Scene:
    """All processes of the benchmark but the subjects."""

    def __init__(self, folder: Path, rate: float) -> None:
        """`rate` [Hz] is everybody's."""
        self.folder, self.rate, self.origin = folder, rate, time.monotonic()
        self.robot, leader, neighbour, agent, copy = (free_endpoint() for _ in range(5))
        self.mission = folder / "edge.toml"
        self.mission.write_text(edge.mission(rate))
        self._neighbours = {edge.LEADER: leader, edge.NEIGHBOUR: neighbour}
        self._listen = {"agent": agent, "copy": copy}
        self._outbox = _one_step(self.mission, rate)

    def surroundings(self) -> list[str]:
        """Command line of the neighbours and the monitor."""
        monitored = {
            endpoint: [t.key(ROBOTS[who]) for t in (ODOM, CMD_VEL, POSITION, STATUS)]
            for who, endpoint in self._listen.items()
        }
        plan = json.dumps([self.origin, self.rate, self._neighbours, monitored, load(self.mission).tag])
        return [sys.executable, "-m", "tests.campaigns.bench.surroundings", plan]

    def agent(self) -> list[str]:
        """Command line of the agent."""
        return [sys.executable, "-P", "-m", "formation.agent", *self._agent_arguments()]

    def profiled_agent(self, file: Path) -> list[str]:
        """Command line of the agent with stopwatches."""
        return [
            sys.executable,
            "-m",
            "tests.campaigns.bench.profiled_agent",
            str(file),
            *self._agent_arguments(),
        ]

    def copy(self) -> list[str]:
        """Command line of the script that does with Zenoh what the agent does."""
        status = [out for out in self._outbox if out.key == STATUS.key(edge.FOLLOWER)]
        return self._bare(
            "copy",
            BusConfig(listen=(self._listen["copy"],), connect=tuple(self._neighbours.values())),
            receives=[POSITION.key(robot) for robot in self._neighbours],
            answers=[out for out in self._outbox if out not in status],
            beside=status,
        )

    def echo(self) -> list[str]:
        """Command line of the echo."""
        command = [out for out in self._outbox if out.key == CMD_VEL.key(edge.FOLLOWER)]
        return self._bare("echo", None, receives=[], answers=command, beside=[])

    def _agent_arguments(self) -> list[str]:
        dialled = [word for to in self._neighbours.values() for word in ("-e", to)]
        return [
            str(self.mission), "--robot", edge.FOLLOWER, "--log-level", "warning",
            "--robot-connect", self.robot, "-l", self._listen["agent"], *dialled,
        ]  # fmt: skip

    def _bare(
        self,
        who: str,
        fleet: BusConfig | None,
        receives: list[str],
        answers: list[Outgoing],
        beside: list[Outgoing],
    ) -> list[str]:
        sides = {"robot": BusConfig(mode="client", connect=(self.robot,))} | (
            {"fleet": fleet} if fleet else {}
        )
        repeat = [_row("fleet", ODOM, ROBOTS[who])]
        plan = {
            "sides": {side: json.loads(str(settings_of(config))) for side, config in sides.items()},
            "answer_to": ODOM.key(ROBOTS[who]),
            "hears": receives,
            "answers": [row for row in _rows(ROBOTS[who], answers) if row["side"] in sides],
            "repeats": [row for row in repeat if row["side"] in sides],
            "beside": [row for row in _rows(ROBOTS[who], beside) if row["side"] in sides],
            "period": 0.5,
        }
        return [sys.executable, str(Path(__file__).with_name("bare.py")), json.dumps(plan)]


def _one_step(mission_file: Path, rate: float) -> list[Outgoing]:
    """What an agent in formation control says in one step: command, sign of life, position, status."""
    mission = load(mission_file)
    agent = Agent(mission, edge.FOLLOWER)
    term, outbox = time.time_ns(), list[Outgoing]()
    began = Now(time.monotonic(), time.time())
    for count, beat in enumerate((1000, 1001)):  # the first alone proves no leader alive
        elapsed = count / rate
        now = Now(began.mono + elapsed, began.wall + elapsed)
        attachment = encode_order(
            PositionAttachment(
                publisher_id="bench",
                count=beat,
                order=Order(term=term, beat=beat, mode="run", shape="line"),
                mission=mission.tag,
            )
        )
        inbox = [
            Sample(POSITION.key(robot), encode(edge.position(robot, elapsed, now.wall)), attachment, now.mono)
            for robot in (edge.LEADER, edge.NEIGHBOUR)
        ]
        odometry = Sample(ODOM.key(edge.FOLLOWER), encode(edge.odometry(elapsed, now.wall)), None, now.mono)
        outbox = list(agent.step(now, [*inbox, odometry]))
    return outbox


def _rows(robot: str, outbox: list[Outgoing]) -> list[dict[str, Any]]:
    """An agent's messages as `bare` wants them, in another robot's name, ordered as an agent sends them."""
    topics = [(address(out.key).topic, out) for out in outbox]
    first = [_row(topic.side, topic, robot, out) for topic, out in topics]
    then = [
        _row("fleet" if topic.side == "robot" else "robot", topic, robot, out)
        for topic, out in topics
        if topic != ALIVE
    ]
    return first + then


def _row(side: str, topic: Topic, robot: str, out: Outgoing | None = None) -> dict[str, Any]:
    assert topic.qos is not None
    attachment = out.attachment if out and side == "fleet" else None  # ROS has none on the robot's side
    return {
        "side": side,
        "key": topic.key(robot),
        "priority": topic.qos.priority,
        "express": topic.qos.express,
        "payload": (out.payload if out else b"").hex(),
        "attachment": (attachment or b"").hex(),
    }
