"""What all ROS 2 messages have in common: their table by ROS 2 type, and their parts.

Parts are encoded for a planar robot, with limits for both directions.

``write_*`` writes a part, ``read_*`` reads it; both raise BadMessage for what is not finite, not physical
or not planar.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import ClassVar, Self

from formation.ros2.cdr import Reader, Writer
from formation.wire import BadMessage

MAX_PAYLOAD_BYTES = 64 * 1024
"""Greatest size of a payload that is read, of most types; an Odometry has 724 bytes."""
MAX_POSITION = 1e6
"""[m]"""
MAX_SPEED = 1e3
"""[m/s] and [rad/s]"""
MAX_TILT = 0.2
"""Roll and pitch together [rad]: beyond it a planar heading means nothing."""
_MAX_TILT = math.sin(MAX_TILT / 2.0) ** 2
UNIT_TOLERANCE = 0.01
"""How far the length of a heading or a quaternion may be from 1."""
COVARIANCE_LENGTH = 36
"""Length of a covariance; formation neither fills nor reads it, and the TurtleBot3 sends zeros as well."""


class Message(ABC):
    """A message on the wire; a subclass is one ROS 2 type."""

    __slots__ = ()
    ROS_TYPE: ClassVar[str]
    """``package/msg/Name``."""
    DEFINITION: ClassVar[str]
    """Its fields and constants in ROS 2 Jazzy; `definitions.NESTED` has the types of its fields."""
    TYPE_HASH: ClassVar[str]
    """RIHS01 in ROS 2 Jazzy, as rmw_zenoh writes it into keys."""
    MAX_BYTES: ClassVar[int] = MAX_PAYLOAD_BYTES
    """Greatest size that is sent or read."""

    def __init_subclass__(cls) -> None:
        """Enter the class in the table."""
        BY_TYPE[cls.ROS_TYPE] = cls

    @abstractmethod
    def _write(self, to: Writer) -> None:
        """Write the fields. Raises BadMessage for values that no receiver would accept."""

    @classmethod
    @abstractmethod
    def _read(cls, source: Reader) -> Self:
        """Read the fields. Raises BadMessage."""


BY_TYPE: dict[str, type[Message]] = {}
"""Every message class, by its ROS 2 type."""


def within(what: str, limit: float, *numbers: float) -> None:
    """Refuse numbers that are not finite or beyond ±`limit`."""
    for number in numbers:
        if not -limit <= number <= limit:
            raise BadMessage(f"{what} is {number:g}, must be a number within ±{limit:g}")


def write_text(to: Writer, text: str) -> None:
    """Write `text`, with a space for each character that cannot be encoded or shown in a terminal."""
    to.text(text if text.isprintable() else "".join(c if c.isprintable() else " " for c in text))


def read_text(source: Reader) -> str:
    """Read a text, if a terminal can show it."""
    text = source.text()
    if not text.isprintable():
        raise BadMessage(f"text has a control character: {text[:40]!r}")
    return text


def write_header(to: Writer, stamp: float, frame: str) -> None:
    """std_msgs/Header; `stamp` [s since the epoch]."""
    write_stamp(to, stamp)
    write_text(to, frame)


def read_header(source: Reader) -> tuple[float, str]:
    """Stamp [s] and frame."""
    return read_stamp(source), read_text(source)


def write_stamp(to: Writer, stamp: float) -> None:
    """builtin_interfaces/Time [s since the epoch]."""
    if not 0.0 <= stamp < 2**31:
        raise BadMessage(f"stamp is {stamp:g} s, must be from 0 to 2^31 s")
    seconds = int(stamp)
    nanoseconds = round((stamp - seconds) * 1e9)
    if nanoseconds == 1_000_000_000:
        seconds, nanoseconds = seconds + 1, 0
    if seconds == 2**31:
        raise BadMessage(f"stamp is {stamp:g} s, must be from 0 to 2^31 s")
    to.time(seconds, nanoseconds)


def read_stamp(source: Reader) -> float:
    """builtin_interfaces/Time [s since the epoch]."""
    seconds, nanoseconds = source.time()
    if not 0 <= seconds < 2**31 - 1 or nanoseconds >= 1_000_000_000:
        raise BadMessage(f"stamp is {seconds} s and {nanoseconds} ns, must be from 0 to 2^31 s and under 1 s")
    return seconds + nanoseconds * 1e-9


def write_pose(to: Writer, position: complex, heading: complex) -> None:
    """geometry_msgs/Pose: `heading` e^{iθ} becomes a turn by θ about z."""
    z, w = half_turn(heading)
    within("position", MAX_POSITION, position.real, position.imag)
    to.doubles(position.real, position.imag, 0.0, 0.0, 0.0, z, w)


def read_pose(source: Reader) -> tuple[complex, complex]:
    """Position [m] and heading e^{iθ}, unit."""
    x, y, z, *orientation = source.doubles(7)
    heading = heading_of(*orientation)
    within("position", MAX_POSITION, x, y, z)
    return complex(x, y), heading


def half_turn(heading: complex) -> tuple[float, float]:
    """z and w of the geometry_msgs/Quaternion of `heading` e^{iθ}, without trigonometry."""
    length = abs(heading)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise BadMessage(f"heading has length {length:g}, must be 1")
    cosine, sine = heading.real / length, heading.imag / length
    if cosine >= 0.0:
        w = math.sqrt((1.0 + cosine) / 2.0)
        return sine / (2.0 * w), w
    z = math.copysign(math.sqrt((1.0 - cosine) / 2.0), sine)  # from z, which is then the larger of the two
    return z, sine / (2.0 * z)


def heading_of(x: float, y: float, z: float, w: float) -> complex:
    """e^{iθ}, unit, of a geometry_msgs/Quaternion that turns about z, or nearly so."""
    tilt = x * x + y * y  # sin² of half the angle between the robot's z axis and the world's
    norm = tilt + z * z + w * w
    if not abs(norm - 1.0) <= 2.0 * UNIT_TOLERANCE:
        raise BadMessage(f"orientation has length {math.sqrt(norm):g}, must be 1")
    if tilt > _MAX_TILT:
        angle = 2.0 * math.asin(min(1.0, math.sqrt(tilt)))
        raise BadMessage(f"robot is tilted by {angle:.2f} rad, must be at most {MAX_TILT}")
    heading = complex(norm - 2.0 * (y * y + z * z), 2.0 * (w * z + x * y))
    return heading / abs(heading)


def write_twist(to: Writer, speed: float, turn_rate: float) -> None:
    """geometry_msgs/Twist [m/s; rad/s]."""
    within("speed", MAX_SPEED, speed)
    within("turn rate", MAX_SPEED, turn_rate)
    to.doubles(speed, 0.0, 0.0, 0.0, 0.0, turn_rate)


def read_twist(source: Reader) -> tuple[float, float]:
    """Forward speed [m/s] and turn rate [rad/s]; of the other components only that they are physical."""
    speed, y, z, roll, pitch, turn_rate = source.doubles(6)
    within("speed", MAX_SPEED, speed, y, z)
    within("turn rate", MAX_SPEED, turn_rate, roll, pitch)
    return speed, turn_rate
