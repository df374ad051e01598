"""The command lines of everybody in the scene: the agent, its two yardsticks, and their surroundings."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

from agent.core import Agent
from formation.bus import BusConfig, _settings
from formation.messages import encode
from formation.mission_file import load
from formation.order import Order, Told
from formation.order import encode as encode_order
from formation.topics import CMD_VEL, ODOM, POSITION, STATUS, TABLE
from formation.wire import Now, Outgoing, Sample
from tests.bench import edge
from tests.processes.child import free_endpoint

ROBOTS = {"agent": edge.FOLLOWER, "copy": "copy", "echo": "echo"}
"""In whose name each subject speaks."""


class Scene:
    """All processes of the benchmark but the subjects."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.origin = folder, time.monotonic()
        self.robot, leader, neighbour, agent, copy = (free_endpoint() for _ in range(5))
        self.mission = folder / "edge.toml"
        self.mission.write_text(edge.MISSION)
        self._neighbours = {edge.LEADER: leader, edge.NEIGHBOUR: neighbour}
        self._listen = {"agent": agent, "copy": copy}
        self._outbox = _one_step(self.mission)

    def surroundings(self) -> list[str]:
        """Command line of the neighbours and the monitor."""
        monitored = {
            endpoint: [t.key(ROBOTS[who]) for t in (CMD_VEL, POSITION, STATUS)]
            for who, endpoint in self._listen.items()
        }
        plan = json.dumps([self.origin, self._neighbours, monitored])
        return [sys.executable, "-m", "tests.bench.surroundings", plan]

    def agent(self) -> list[str]:
        """Command line of the agent."""
        return [sys.executable, "-P", "-m", "agent", *self._agent_arguments()]

    def profiled_agent(self, file: Path) -> list[str]:
        """Command line of the agent with stopwatches."""
        return [sys.executable, "-m", "tests.bench.profiled_agent", str(file), *self._agent_arguments()]

    def copy(self) -> list[str]:
        """Command line of the script that does with Zenoh what the agent does."""
        status = [out for out in self._outbox if out.key == STATUS.key(edge.FOLLOWER)]
        return self._bare(
            "copy",
            BusConfig(listen=(self._listen["copy"],), connect=(*self._neighbours.values(), self.robot)),
            hears=[POSITION.key(robot) for robot in self._neighbours],
            answers=[out for out in self._outbox if out not in status],
            beside=status,
        )

    def echo(self) -> list[str]:
        """Command line of the echo."""
        command = [out for out in self._outbox if out.key == CMD_VEL.key(edge.FOLLOWER)]
        return self._bare("echo", BusConfig(connect=(self.robot,)), hears=[], answers=command, beside=[])

    def _agent_arguments(self) -> list[str]:
        dialled = [word for to in (*self._neighbours.values(), self.robot) for word in ("-e", to)]
        return [
            str(self.mission), "--robot", edge.FOLLOWER, "--log-level", "warning",
            "-l", self._listen["agent"], *dialled,
        ]  # fmt: skip

    def _bare(
        self, who: str, config: BusConfig, hears: list[str], answers: list[Outgoing], beside: list[Outgoing]
    ) -> list[str]:
        plan = {
            "config": json.loads(str(_settings(config))),
            "answer_to": ODOM.key(ROBOTS[who]),
            "hears": hears,
            "answers": [_row(ROBOTS[who], out) for out in answers],
            "beside": [_row(ROBOTS[who], out) for out in beside],
            "period": 0.5,
        }
        return [sys.executable, str(Path(__file__).with_name("bare.py")), json.dumps(plan)]


def _one_step(mission_file: Path) -> list[Outgoing]:
    """What an agent in formation control says in one step: command, position with order, status."""
    mission = load(mission_file)
    agent = Agent(mission, edge.FOLLOWER)
    term, outbox = time.time_ns(), list[Outgoing]()
    for beat in (1000, 1001):  # the first alone proves no leader alive
        now = Now(time.monotonic(), time.time())
        attachment = encode_order(
            Told(voice="bench", count=beat, order=Order(term=term, beat=beat, mode="run", shape="line"))
        )
        inbox = [
            Sample(POSITION.key(robot), encode(edge.position(robot, 0.0, now.wall)), attachment, now.mono)
            for robot in (edge.LEADER, edge.NEIGHBOUR)
        ]
        odometry = Sample(ODOM.key(edge.FOLLOWER), encode(edge.odometry(0.0, now.wall)), None, now.mono)
        outbox = agent.step(now, [*inbox, odometry])
    return outbox


def _row(robot: str, out: Outgoing) -> dict[str, Any]:
    """An agent's message as `bare` wants it, in the name of another robot."""
    topic = next(topic for topic in TABLE if out.key.endswith(f"/{topic.name}"))
    assert topic.qos is not None
    return {
        "key": topic.key(robot),
        "priority": topic.qos.priority,
        "express": topic.qos.express,
        "payload": out.payload.hex(),
        "attachment": (out.attachment or b"").hex(),
    }
