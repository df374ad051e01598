"""A robot, its watchdog, and a driver who is played here and knows himself whether he kept his word.

Times are of the system clock: the robot's stamps, and when what is said about it arrived here. Processes have
the priorities that they have on a robot; this one has not, so its driver may pause: a lapse.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from formation.agent.safety.commander import FAREWELL
from formation.mission.file import load, read
from formation.mission.model import Mission
from formation.ros2.messages import Number, Odometry, Twist, TwistStamped, decode, encode
from formation.ros2.naming import Naming
from formation.topics import ALIVE, CMD_VEL, ODOM, command_topic
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBus
from tests.support.child import Child, free_endpoint, started, until

SPEED = 0.3
PERIOD = 0.05
"""Of the agent and the robot [s]."""
NICE = {
    "formation.agent": -5,
    "formation.agent.watchdog": -15,
    "formation.agent.simulated": -20,
}
"""Priorities by module, as units set them."""
LAPSE = 2.0 * PERIOD
"""A driver who says nothing for longer is not healthy, nor is a robot that says nothing [s]."""
COMMAND, LIFE, RECEIVED = (topic.key("robot2") for topic in (CMD_VEL, ALIVE, ODOM))
PARKED = "parked: the robot may be driven by hand"
"""What a watchdog logs when it has parked its robot."""


class Wheel(NamedTuple):
    """One odometry message."""

    moment: float
    """The robot's stamp [s]."""
    speed: float


class Scene:
    """A mission in one of ROS 2's spellings, its second robot, and who drives that."""

    def __init__(self, stack: ExitStack, folder: Path, ros: str, kind: str) -> None:
        text, _ = read("six_robots")
        table = "[robots.robot2]\n"
        assert table in text
        self.file = folder / "mission.toml"
        self.file.write_text(text.replace(table, f'{table}ros = "{ros}"\ncmd_vel = "{kind}"\n'), "utf-8")
        self.mission: Mission = load(self.file)
        self.endpoint = free_endpoint()
        self._stack, self._mailbox = stack, Mailbox(8192)
        naming = Naming.of(self.mission.robots, ["robot2"])
        self.bus = stack.enter_context(RobotBus((self.endpoint,), naming, self._mailbox, node="driver"))
        self._stamped = kind == "twist_stamped"
        self._topic = command_topic(self.mission.robots["robot2"].cmd_vel)
        self.bus.advertise(self._topic, COMMAND)
        self.bus.advertise(ALIVE, LIFE)
        self.bus.subscribe(ODOM, RECEIVED)
        self.bus.subscribe(ALIVE, LIFE)
        self._wheels: list[Wheel] = []
        self._heard: list[tuple[float, float]] = []  # odometry: when it came, and how late that was [s]
        self._published: list[tuple[float, float]] = []  # commands, whoever gave them: when [s], speed
        self._signs: list[float] = []
        self._lapsed = float("-inf")  # when the driver spoke again after he had said nothing for too long [s]
        self.drove = float("-inf")
        """When the driver spoke last [s]."""

    def robot(self) -> Child:
        """Start the robot."""
        flags = ["--robot", "robot2", "-l", self.endpoint]
        nice = NICE["formation.agent.simulated"]
        child = self._stack.enter_context(
            started("formation.agent.simulated", str(self.file), *flags, nice=nice)
        )
        child.event("ready")
        until(lambda: bool(self.bus.routed(COMMAND)))
        return child

    def listen(self) -> None:
        """Hear all commands from now on; whoever gives them then sees a listener, whatever the robot does."""
        self.bus.subscribe(self._topic, COMMAND)

    def watchdog(self, *flags: str) -> Child:
        """Start a watchdog that dials the robot."""
        links = ["--robot", "robot2", "--robot-connect", self.endpoint]
        module = "formation.agent.watchdog"
        child = self._stack.enter_context(started(module, str(self.file), *links, *flags, nice=NICE[module]))
        if "--once" not in flags:
            child.event("ready")
        return child

    def drive(self, seconds: float, *, alive: bool) -> list[Wheel]:
        """Command straight on, as the agent if `alive`, else as another process; return what the wheels did.

        Ends after `seconds` without a lapse, in which no process was healthy.
        """
        over, begun = threading.Event(), threading.Event()
        self._lapsed = self.drove = time.time()

        def drive() -> None:
            while not over.is_set():
                now = time.time()
                if now - self.drove > LAPSE:
                    self._lapsed = now
                self.command()
                if alive:
                    self.bus.publish(LIFE, encode(Number(now)))
                self.drove = now
                begun.set()
                over.wait(PERIOD)

        driver = threading.Thread(target=drive, name="driver")
        driver.start()
        try:
            begun.wait()
            until(lambda: self.drove > self._lapsed + LAPSE + seconds)
            since, end = self._lapsed + LAPSE, self.drove
            until(lambda: self.wheels()[-1].moment > end)
        finally:
            over.set()
            driver.join()
        return [one for one in self.wheels(since) if one.moment <= end]

    def command(self) -> float:
        """Have the robot drive; when that was said [s]."""
        now = time.time()
        command = TwistStamped(now, SPEED, 0.0) if self._stamped else Twist(SPEED, 0.0)
        self.bus.publish(COMMAND, encode(command))
        return now

    def leave(self) -> float:
        """Take an agent's leave; when that was said [s]."""
        now = time.time()
        self.bus.publish(LIFE, encode(Number(FAREWELL)))
        return now

    def stands(self, since: float) -> Wheel:
        """Wait until, after `since` [s], the robot stands; the first odometry that says so."""
        until(lambda: any(one.speed == 0.0 for one in self.wheels(since)))
        return next(one for one in self.wheels(since) if one.speed == 0.0)

    def newest(self) -> Wheel:
        """The next odometry that the robot makes."""
        now = time.time()
        until(lambda: bool(self.wheels(now)))
        return self.wheels(now)[0]

    def obeyed(self, sent: float) -> float:
        """How long the wheels obey the command given at `sent` [s], by stamps, until they stand again [s].

        It has come when they turn, or when zero was said twice since: in between they may stand again.
        """
        until(lambda: any(one.speed for one in self.wheels(sent)) or len(self.zeros(sent)) > 1)
        turning = [one.moment for one in self.wheels(sent) if one.speed]
        start = turning[0] if turning else time.time()
        return self.ran(start, self.stands(start).moment)

    def wheels(self, since: float = 0.0) -> list[Wheel]:
        """What the wheels did since [s]."""
        self._look()
        return [one for one in self._wheels if one.moment > since]

    def zeros(self, since: float = 0.0) -> list[float]:
        """When somebody told the robot to stand since [s]: nobody here does."""
        self._look()
        return [moment for moment, speed in self._published if moment > since and speed == 0.0]

    def last_word(self) -> float:
        """The speed that the robot was told last."""
        self._look()
        return self._published[-1][1]

    def signs(self, since: float) -> list[float]:
        """When an agent gave signs of life since [s]."""
        self._look()
        return [moment for moment in self._signs if moment > since]

    def ran(self, start: float, end: float) -> float:
        """How long it is between two times [s], without those in which this machine stood still.

        The robot's process goes before all others: if it says nothing for long, nobody had a chance to.
        """
        stamps = [start, *(one.moment for one in self.wheels(start) if one.moment < end), end]
        return sum(min(after - before, LAPSE) for before, after in pairwise(stamps))

    def late(self, start: float, end: float) -> float:
        """How late, at most, what was said then was heard here: as late as odometry about that time [s]."""
        until(lambda: self.wheels()[-1].moment > end)
        return max(late for came, late in self._heard if came > start - LAPSE and came - late < end + LAPSE)

    def _look(self) -> None:
        behind = time.time() - time.monotonic()
        for one in self._mailbox.drain():
            if one.key == RECEIVED:
                odometry = decode(Odometry, one.payload)
                self._wheels.append(Wheel(odometry.stamp, odometry.speed))
                self._heard.append((one.arrived + behind, one.arrived + behind - odometry.stamp))
            elif one.key == LIFE:
                self._signs.append(one.arrived + behind)
            else:
                raw = one.payload
                twist = decode(TwistStamped, raw) if self._stamped else decode(Twist, raw)
                self._published.append((one.arrived + behind, twist.speed))


def gaps(moments: Sequence[float]) -> int:
    """How often what should come each period came later than two after the one before."""
    return sum(after - before > LAPSE for before, after in pairwise(moments))
