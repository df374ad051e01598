"""Looks on from outside every process that is judged, and writes what it sees as JSON lines.

``python -m tests.campaigns.reliability.witness MISSION FILE FLEET ROBOTS``: every command that reaches a
robot's wheels, where each robot really is, and every position that anybody says as the leader. FLEET and
ROBOTS map names to endpoints, in JSON. Of these lines the judge makes its verdicts
(`tests.campaigns.reliability.seen`):

    ["command", at, robot, speed, turn rate]                             [s, monotonic; m/s; rad/s]
    ["truth", at, robot, x, y, heading]                                  centre [m; rad; world frame]
    ["lead", at, x, y, {what was attached}]
"""

from __future__ import annotations

import cmath
import json
import sys
import time
from contextlib import closing
from typing import Any

from formation.mission.file import load
from formation.mission.model import Mission
from formation.protocol import json_message
from formation.protocol.attachment import PositionAttachment
from formation.ros2.messages import Pose, Twist, TwistStamped, decode
from formation.topics import CMD_VEL, GROUND_TRUTH, POSITION, command_topic
from formation.transport.bus import Bus, BusConfig
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.transport.runtime.process import say
from formation.wire import BadMessage, Sample

PLAUSIBLE = 0.5  # a stamp so far from when it arrived is of a clock that was set, and tells nothing [s]


class Eyes:
    """Turns samples into lines."""

    def __init__(self, mission: Mission) -> None:
        self._lead = POSITION.key(mission.leader)
        self._commands = {CMD_VEL.key(name): name for name in mission.followers}
        self._truths = {GROUND_TRUTH.key(name): name for name in mission.followers}
        self._stamped = {name for name in mission.followers if mission.robots[name].cmd_vel != "twist"}

    def line(self, sample: Sample, ahead: float) -> list[Any]:
        """One line; `ahead` is our system clock before the monotonic one [s]. Raises BadMessage."""
        if (robot := self._commands.get(sample.key)) is not None:
            stamped = robot in self._stamped
            twist = decode(TwistStamped, sample.payload) if stamped else decode(Twist, sample.payload)
            return ["command", sample.arrived, robot, twist.speed, twist.turn_rate]
        pose = decode(Pose, sample.payload)
        at = pose.stamp - ahead
        if abs(at - sample.arrived) > PLAUSIBLE:
            at = sample.arrived
        x, y = pose.position.real, pose.position.imag
        if sample.key == self._lead:
            attachment = json_message.decode(PositionAttachment, sample.attachment or b"{}")
            return ["lead", at, x, y, attachment.model_dump(exclude_defaults=True)]
        return ["truth", at, self._truths[sample.key], x, y, cmath.phase(pose.heading)]


def main(source: str, file: str, fleet: str, robots: str) -> None:
    mission, box = load(source), Mailbox(1 << 16)
    eyes, stage = Eyes(mission), json.loads(robots)
    links = BusConfig(connect=tuple(json.loads(fleet)), namespace=mission.team or "", name="witness")
    with (
        open(file, "w", encoding="utf-8") as out,  # noqa: PTH123 - it is appended to for an hour
        Bus(links, box) as bus,
        closing(RobotBuses(mission, stage, box, node="witness")) as sides,
    ):
        bus.subscribe(POSITION.key(mission.leader))
        for name in stage:
            sides.subscribe(command_topic(mission.robots[name].cmd_vel), CMD_VEL.key(name))
            sides.subscribe(GROUND_TRUTH, GROUND_TRUTH.key(name))
        say("ready", process="witness")
        while True:
            box.wait(0.2)
            ahead = time.time() - time.monotonic()
            for sample in box.drain():
                try:
                    print(json.dumps(eyes.line(sample, ahead)), file=out)
                except BadMessage as bad:
                    print(json.dumps(["bad", sample.arrived, sample.key, str(bad)]), file=out)
            out.flush()
            time.sleep(0.02)


if __name__ == "__main__":
    main(*sys.argv[1:])
