"""`formation drive`: drive the leader by hand while a key, a stick or a topic says so."""

from __future__ import annotations

import argparse
import os
import select
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from uuid import uuid4

from formation.deploy.arguments import add_links, number, parser, read_mission
from formation.deploy.driving.inputs import KEY_SECONDS, QUIT, RELEASED, Gamepad, Keys, Share, Twists
from formation.deploy.driving.remote import PERIOD_SECONDS, Remote
from formation.deploy.driving.ros import add_router, listening, router, topic
from formation.deploy.links import operator_bus
from formation.deploy.refusal import Refusal, refuse_errors
from formation.mission.file import MISSION_HELP
from formation.mission.model import Mission
from formation.protocol.order import DRIVE_TIMEOUT_SECONDS
from formation.ros2.cdr import MAX_PADDING_BYTES
from formation.ros2.messages import Twist, TwistStamped, decode, encode
from formation.stability.driving import first_limits
from formation.transport.bus import Bus
from formation.transport.bus_config import BusError
from formation.transport.mailbox import Question
from formation.transport.runtime.clock import monotonic
from formation.wire import BadMessage

KEYS = """\
Keys, as of ROS 2's teleop_twist_keyboard (or the arrows); let go to stop, q ends:

  u  i  o      forward and left, forward, forward and right
  j  k  l      turn left, stop, turn right
  m  ,  .      back
"""
MAX_KEY_BYTES = 4096
"""Most that is read at once [bytes]; a terminal keeps no more."""
CONTRADICTION = (
    "commands change back and forth, as of two nodes that publish: end one, or put twist_mux before it"
)
EXAMPLES = f"""\
  formation drive convoy                       with the keys of this terminal
  formation drive convoy --speed 0.1           at most 0.1 m/s
  formation drive convoy --gamepad             /dev/input/js0: hold the left shoulder button, left stick
  formation drive convoy --topic /cmd_vel      a ROS topic of Twist or TwistStamped, as of teleop_twist_joy

{KEYS}
When you let go of a gamepad's button, the leader orders all robots to hold at once. Keys: up to 0.6 s after
a tap, 0.15 s after a held key. --topic: 0.3 s after the last message. If nothing reaches the leader: 0.3 s
after the newest input that did. Each robot holds when the order reaches it: the delays of all hops add up,
and have no limit if they are the same from the start. To end a hold, order `run`; to end a stop, order
`release`, then `run`. An order of a speed or a route ends the drive: let go, then drive again.

Exit code 0: ended by the driver; 1: the input failed; 2: nothing was started.
"""


class Ended(Exception):  # noqa: N818 - no error
    """The drive is over."""

    def __init__(self, code: int, why: str) -> None:
        super().__init__(why)
        self.code = code


def main(arguments: Sequence[str]) -> int:
    """Drive; return the exit code."""
    options = _options().parse_args(arguments)
    mission = read_mission(options.mission)
    most = first_limits(mission)
    speed = _within("--speed", options.speed, most.speed, "m/s")
    turn_rate = _within("--turn-rate", options.turn_rate, most.turn_rate, "rad/s")
    with (
        refuse_errors(BusError),
        _input(options, speed, turn_rate) as read,
        operator_bus(options, mission, mission.candidates) as bus,
    ):
        drive = _Drive(bus, mission, speed, turn_rate)
        try:
            while True:
                drive.step(read())
        except (Ended, KeyboardInterrupt) as end:
            drive.step(RELEASED)
            ended = end if isinstance(end, Ended) else Ended(0, "drive ended")
            print(f"\nformation: {ended}: {drive.outcome}", file=sys.stderr)
            return ended.code


def _within(flag: str, value: float | None, most: float, unit: str) -> float:
    """Return the `value` of a flag, or `most` without one. Raises Refusal for more."""
    if value is not None and value > most:
        raise Refusal(f"{flag} {value:g} {unit}: must be at most {most:.4g}, which the followers can follow")
    return most if value is None else value


def erased(line: str, columns: int) -> str:
    """Return what erases a line at the cursor's left that a terminal of so many columns has wrapped."""
    above = max(0, len(line) - 1) // columns
    return f"\r\x1b[{above}A\x1b[J" if above else "\r\x1b[J"


class _Drive:
    """Sends a velocity each period, and shows how the drive goes."""

    def __init__(self, bus: Bus, mission: Mission, speed: float, turn_rate: float) -> None:
        self._bus, self._speed, self._turn_rate = bus, speed, turn_rate
        self._remote, self._name = Remote(mission, f"driver-{uuid4().hex[:12]}"), mission.name
        self._open: list[tuple[Question, float]] = []
        self._shown = ""

    @property
    def outcome(self) -> str:
        """What the robots do after the drive, as far as the leader's answers tell."""
        state = self._remote.state
        if state.reply is None:
            return f"no leader of {self._name} has answered, so what the robots do is not known; does it run?"
        if (silent := monotonic() - state.answered) > DRIVE_TIMEOUT_SECONDS:  # others may move it meanwhile
            name = state.reply.robot
            return (
                f"{name} has not answered for {silent:.1f} s, so what the robots do is not known; watch them"
            )
        return f"{state.reply.robot} did not obey: {state.refusal}" if state.refusal else "all robots hold"

    def step(self, share: Share) -> None:
        """Send the velocity, take answers for a period, and show the state."""
        sent = monotonic()
        forward, turn_rate = share.forward * self._speed, share.turn * self._turn_rate
        keys, payload = self._remote.request(forward, turn_rate, sent)
        self._open += [(self._bus.question(key, payload, DRIVE_TIMEOUT_SECONDS), sent) for key in keys]
        while (now := monotonic()) < sent + PERIOD_SECONDS:
            self._collect_answers(now)
            time.sleep(0.002)
        self._show(f"{forward:+.2f} m/s {turn_rate:+.2f} rad/s  {self._remote.state.words(now)}")

    def _collect_answers(self, now: float) -> None:
        waiting = []
        for question, sent in self._open:
            replies = [reply.payload for reply in list(question.replies)]
            self._remote.process_replies(replies, sent, now)
            if not replies and not question.over and now - sent < DRIVE_TIMEOUT_SECONDS:
                waiting.append((question, sent))
        self._open = waiting

    def _show(self, line: str) -> None:
        if sys.stderr.isatty():
            columns = os.get_terminal_size(sys.stderr.fileno()).columns or 80
            print(f"{erased(self._shown, columns)}{line}", end="", file=sys.stderr, flush=True)
            self._shown = line
            return
        what = line.partition("  ")[2].partition(", answers")[0]
        if what != self._shown:
            print(line, file=sys.stderr, flush=True)
        self._shown = what


def _input(
    options: argparse.Namespace, speed: float, turn_rate: float
) -> AbstractContextManager[Callable[[], Share]]:
    """Return a context with a function that reads the chosen input. Raises Refusal."""
    if options.topic is None and (options.ros, options.domain) != (None, None):
        raise Refusal("--ros and --domain are of use with --topic only")
    if options.topic:
        return _topic(options, Twists(speed, turn_rate))
    return _gamepad(options.gamepad) if options.gamepad else _keys()


@contextmanager
def _topic(options: argparse.Namespace, twists: Twists) -> Iterator[Callable[[], Share]]:
    def read() -> Share:
        for sample in bus.drain():
            try:
                twist = decode(_type_of(sample.payload), sample.payload)
            except BadMessage as bad:
                raise Ended(1, f"{sample.key}: {bad}") from None
            twists.add(twist.speed, twist.turn_rate, sample.arrived)
            if twists.contradict:
                raise Ended(1, f"{sample.key}: {CONTRADICTION}")
        return twists.velocity(monotonic())

    with listening(*router(options), (options.topic,)) as bus:
        yield read


def _type_of(payload: bytes) -> type[Twist | TwistStamped]:
    """Return the type of a command's message, which the key names only with rmw_zenoh: a Twist is shorter."""
    longest = len(encode(Twist(0.0, 0.0))) + MAX_PADDING_BYTES
    return Twist if len(payload) <= longest else TwistStamped


@contextmanager
def _gamepad(path: Path) -> Iterator[Callable[[], Share]]:
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except OSError as error:
        raise Refusal(f"--gamepad {path}: {error.strerror}; is it plugged in?") from None
    gamepad = Gamepad()

    def read() -> Share:
        gamepad.read(file)
        share = gamepad.velocity(monotonic())
        if share is None:
            raise Ended(1, f"{path} failed")
        return share

    try:
        yield read
    finally:
        os.close(file)


@contextmanager
def _keys() -> Iterator[Callable[[], Share]]:
    if not sys.stdin.isatty():
        raise Refusal("stdin is no terminal: choose --gamepad or --topic")
    import termios  # noqa: PLC0415 - only where there is a terminal
    import tty  # noqa: PLC0415

    file, keys = sys.stdin.fileno(), Keys()
    before, last_read = termios.tcgetattr(file), monotonic()

    def read() -> Share:
        nonlocal last_read
        now = monotonic()
        waited, last_read = now - last_read > KEY_SECONDS, now
        while select.select([file], [], [], 0.0)[0]:
            data = os.read(file, MAX_KEY_BYTES)
            if not data:
                raise Ended(1, "the terminal is gone")
            text = data.decode(errors="replace")
            if not waited or QUIT & set(text):  # keys that have waited may have been let go
                keys.press(text, now)
        if keys.quits:
            raise Ended(0, "drive ended")
        return keys.velocity(now)

    print(KEYS, file=sys.stderr, flush=True)
    try:
        tty.setcbreak(file)
        yield read
    finally:
        termios.tcsetattr(file, termios.TCSADRAIN, before)


def _options() -> argparse.ArgumentParser:
    options = parser("drive", "Drive the leader by hand; all robots hold when you let go.", EXAMPLES)
    options.add_argument("mission", metavar="MISSION", help=MISSION_HELP)
    source = options.add_mutually_exclusive_group()
    source.add_argument(
        "--gamepad",
        type=Path,
        nargs="?",
        const=Path("/dev/input/js0"),
        metavar="DEVICE",
        help="a Linux joystick (default /dev/input/js0): hold its left shoulder button",
    )
    source.add_argument(
        "--topic",
        type=topic,
        metavar="TOPIC",
        help="geometry_msgs/Twist or TwistStamped messages of this ROS topic; stamps do not count",
    )
    options.add_argument(
        "--speed",
        type=number(0.0, 100.0, "m/s", open_below=True),
        metavar="M/S",
        help="greatest speed (default: what followers can follow)",
    )
    options.add_argument(
        "--turn-rate",
        type=number(0.0, 100.0, "rad/s", open_below=True),
        metavar="RAD/S",
        help="greatest turn rate, likewise",
    )
    add_router(options)
    add_links(options)
    return options
