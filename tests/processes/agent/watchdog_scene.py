"""A simulated robot, its watchdog, and a driver that is played by the test and measures its own lapses.

Times are of the system clock: the robot's stamps, and when messages arrived in this process. Processes have
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
"""Period of the agent and the robot [s]."""
NICE = {
    "formation.agent": -5,
    "formation.agent.watchdog": -15,
    "formation.agent.simulated": -20,
}
"""Priorities by module, as systemd units set them."""
LAPSE = 2.0 * PERIOD
"""Longest silence of a healthy driver or robot [s]."""
COMMAND, LIFE, ODOM_KEY = (topic.key("robot2") for topic in (CMD_VEL, ALIVE, ODOM))
PARKED = "parked: the robot may be driven by hand"
"""A watchdog logs this when it has parked its robot."""


class Wheel(NamedTuple):
    """One odometry message."""

    moment: float
    """The robot's stamp [s]."""
    speed: float


class Scene:
    """A mission for one ROS 2 transport and command type, its robot2, and the driver of robot2."""

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
        self.bus.subscribe(ODOM, ODOM_KEY)
        self.bus.subscribe(ALIVE, LIFE)
        self._wheels: list[Wheel] = []
        self._delays: list[tuple[float, float]] = []  # odometry: when it arrived, its delay [s]
        self._published: list[tuple[float, float]] = []  # commands of every sender: when [s], speed
        self._signs_of_life: list[float] = []
        self._lapsed = float("-inf")  # when the driver's last lapse ended [s]
        self.drove = float("-inf")
        """When the driver sent last [s]."""

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
        """Receive all commands from now on; their senders then see a listener, even without the robot."""
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
        """Command straight motion, as the agent if `alive`, else as another process; return the odometry.

        Ends after `seconds` without a lapse: in a lapse, no process is healthy.
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
            until(lambda: self.odometry()[-1].moment > end)
        finally:
            over.set()
            driver.join()
        return [one for one in self.odometry(since) if one.moment <= end]

    def command(self) -> float:
        """Command the robot to drive; return when [s]."""
        now = time.time()
        command = TwistStamped(now, SPEED, 0.0) if self._stamped else Twist(SPEED, 0.0)
        self.bus.publish(COMMAND, encode(command))
        return now

    def send_farewell(self) -> float:
        """Send an agent's farewell; return when [s]."""
        now = time.time()
        self.bus.publish(LIFE, encode(Number(FAREWELL)))
        return now

    def wait_for_standstill(self, since: float) -> Wheel:
        """Wait until the robot stands after `since` [s]; return the first odometry that shows it."""
        until(lambda: any(one.speed == 0.0 for one in self.odometry(since)))
        return next(one for one in self.odometry(since) if one.speed == 0.0)

    def next_odometry(self) -> Wheel:
        """Wait for the next odometry of the robot."""
        now = time.time()
        until(lambda: bool(self.odometry(now)))
        return self.odometry(now)[0]

    def time_obeyed(self, sent: float) -> float:
        """Return how long the wheels obey the command sent at `sent` [s], until they stand again [s].

        It has arrived when they turn, or when zero was sent twice since: in between they may stand again.
        """
        until(lambda: any(one.speed for one in self.odometry(sent)) or len(self.times_of_zero(sent)) > 1)
        turning = [one.moment for one in self.odometry(sent) if one.speed]
        start = turning[0] if turning else time.time()
        return self.time_without_stalls(start, self.wait_for_standstill(start).moment)

    def odometry(self, since: float = 0.0) -> list[Wheel]:
        """Return the odometry since this time [s]."""
        self._drain()
        return [one for one in self._wheels if one.moment > since]

    def times_of_zero(self, since: float = 0.0) -> list[float]:
        """Return when zero was commanded since this time [s]; the driver never commands zero."""
        self._drain()
        return [moment for moment, speed in self._published if moment > since and speed == 0.0]

    def last_speed(self) -> float:
        """Return the newest commanded speed."""
        self._drain()
        return self._published[-1][1]

    def signs_of_life(self, since: float) -> list[float]:
        """Return when agents sent signs of life since this time [s]."""
        self._drain()
        return [moment for moment in self._signs_of_life if moment > since]

    def time_without_stalls(self, start: float, end: float) -> float:
        """Return the time between `start` and `end` [s] without stalls of this machine.

        The robot's process has the highest priority: if it is silent for long, no other could run either.
        """
        stamps = [start, *(one.moment for one in self.odometry(start) if one.moment < end), end]
        return sum(min(after - before, LAPSE) for before, after in pairwise(stamps))

    def max_delay(self, start: float, end: float) -> float:
        """Return the largest delay of odometry, as a bound for all messages, about that time [s]."""
        until(lambda: self.odometry()[-1].moment > end)
        return max(late for at, late in self._delays if at > start - LAPSE and at - late < end + LAPSE)

    def _drain(self) -> None:
        behind = time.time() - time.monotonic()
        for one in self._mailbox.drain():
            if one.key == ODOM_KEY:
                odometry = decode(Odometry, one.payload)
                self._wheels.append(Wheel(odometry.stamp, odometry.speed))
                self._delays.append((one.arrived + behind, one.arrived + behind - odometry.stamp))
            elif one.key == LIFE:
                self._signs_of_life.append(one.arrived + behind)
            else:
                raw = one.payload
                twist = decode(TwistStamped, raw) if self._stamped else decode(Twist, raw)
                self._published.append((one.arrived + behind, twist.speed))


def gaps(moments: Sequence[float]) -> int:
    """Return how many times are more than two periods after the one before."""
    return sum(after - before > LAPSE for before, after in pairwise(moments))
