"""What a ROS 2 message class states about itself, and the table of all such classes by their ROS 2 type."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Self

from formation.ros2.cdr import Reader, Writer


class Message(ABC):
    """A message on the wire; a subclass is one ROS 2 type."""

    __slots__ = ()
    ROS_TYPE: ClassVar[str]
    """``package/msg/Name``."""
    DEFINITION: ClassVar[str]
    """Its fields and constants in ROS 2 Jazzy; `formation.ros2.definitions` has the types of its fields."""
    TYPE_HASH: ClassVar[str]
    """RIHS01 in ROS 2 Jazzy, as rmw_zenoh writes it into keys."""

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
