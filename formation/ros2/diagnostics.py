"""What robots and processes report of themselves: states, and events in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain
from typing import ClassVar, Self

from formation.ros2 import ros
from formation.ros2.cdr import Reader, Writer
from formation.ros2.ros import Message
from formation.wire import BadMessage


@dataclass(frozen=True, slots=True)
class Status:
    """diagnostic_msgs/DiagnosticStatus: the state of one thing."""

    name: str
    level: int
    """0 ok, 1 warning, 2 error, 3 stale."""
    message: str
    hardware_id: str = ""
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Diagnostics(Message):
    """diagnostic_msgs/DiagnosticArray: several statuses of one moment [s, sender's system clock]."""

    ROS_TYPE: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"
    DEFINITION: ClassVar[str] = "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n"
    TYPE_HASH: ClassVar[str] = "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"
    stamp: float
    statuses: tuple[Status, ...]

    def _write(self, to: Writer) -> None:
        ros.write_header(to, self.stamp, "")
        to.count(len(self.statuses))
        for status in self.statuses:
            to.octet(_level(status.level))
            for text in (status.name, status.message, status.hardware_id):
                ros.write_text(to, text)
            to.count(len(status.values))
            for text in chain.from_iterable(status.values.items()):
                ros.write_text(to, text)

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, _ = ros.read_header(source)
        statuses = []
        for _ in range(source.count()):
            level = _level(source.octet())
            name, message, hardware_id = (ros.read_text(source) for _ in range(3))
            values = {ros.read_text(source): ros.read_text(source) for _ in range(source.count())}
            statuses.append(Status(name, level, message, hardware_id, values))
        return cls(stamp, tuple(statuses))


@dataclass(frozen=True, slots=True)
class LogEntry(Message):
    """rcl_interfaces/Log: an event, in words."""

    ROS_TYPE: ClassVar[str] = "rcl_interfaces/msg/Log"
    DEFINITION: ClassVar[str] = (
        "uint8 DEBUG=10\nuint8 INFO=20\nuint8 WARN=30\nuint8 ERROR=40\nuint8 FATAL=50\n"
        "builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\n"
        "string function\nuint32 line\n"
    )
    TYPE_HASH: ClassVar[str] = "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac"
    stamp: float
    """[s, sender's system clock]"""
    level: int
    """10 debug, 20 info, 30 warning, 40 error, 50 fatal."""
    name: str
    """Name of the robot or process that it is about."""
    text: str
    kind: str = ""
    """Kind of event, in one word; ROS calls the field `function`."""

    def _write(self, to: Writer) -> None:
        ros.write_stamp(to, self.stamp)
        to.octet(_log_level(self.level))
        for text in (self.name, self.text, "", self.kind):  # the third is a file …
            ros.write_text(to, text)
        to.count(0)  # … and this a line in it

    @classmethod
    def _read(cls, source: Reader) -> Self:
        stamp, level = ros.read_stamp(source), _log_level(source.octet())
        name, text = ros.read_text(source), ros.read_text(source)
        source.text()
        kind = ros.read_text(source)
        source.count()
        return cls(stamp, level, name, text, kind)


def _level(level: int) -> int:
    if level not in range(4):
        raise BadMessage(f"level is {level}, must be 0 (ok), 1 (warning), 2 (error) or 3 (stale)")
    return level


def _log_level(level: int) -> int:
    if level not in {10, 20, 30, 40, 50}:
        raise BadMessage(f"level is {level}, must be 10 (debug), 20, 30, 40 or 50 (fatal)")
    return level
