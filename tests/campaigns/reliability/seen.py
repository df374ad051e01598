"""What a witness saw: commands, true places and leaders' words, each in the order of time."""

from __future__ import annotations

import io
import json
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from formation.mission.model import Mission
from formation.protocol.attachment import PositionAttachment
from formation.protocol.order import Order
from formation.slots.shape import PlacedShape

Floats = NDArray[np.float64]
Points = NDArray[np.complex128]


class Commanded(NamedTuple):
    """One command that arrived at a robot's wheels."""

    at: float  # [s, monotonic]
    speed: float  # [m/s]
    turn_rate: float  # [rad/s]

    @property
    def zero(self) -> bool:
        """Whether it tells the robot to stand."""
        return self.speed == 0.0 and self.turn_rate == 0.0


class Placed(NamedTuple):
    """Where a robot really was."""

    at: float  # [s, monotonic]
    point: complex  # control point [m; world frame]


class Led(NamedTuple):
    """What somebody said as the leader."""

    at: float  # [s, monotonic]
    point: complex  # [m; world frame]
    publisher_id: str  # of the process that said it
    term: int
    mode: str
    slots: tuple[complex, ...]
    """Where it wanted everybody, over ``mission.names`` [m; world frame, from the leader]."""
    formed: str = ""  # the shape that it had come to by then; empty while shapes are mixed

    @classmethod
    def of(
        cls, at: float, point: complex, attachment: PositionAttachment, order: Order, mission: Mission
    ) -> Led:
        """What `attachment` says with the position `point`."""
        placed_shape = PlacedShape.of(order)
        slots, mix = tuple(placed_shape.slots(mission)), placed_shape.mix
        formed = mix[0][0] if len(mix) == 1 else ""
        return cls(at, point, attachment.publisher_id, order.term, order.mode, slots, formed)


T = TypeVar("T", Commanded, Placed, Led)


class Seen:
    """Lines of a witness, read on as they come."""

    def __init__(self, mission: Mission, path: Path | None = None) -> None:
        self.mission = mission
        self.commands: dict[str, list[Commanded]] = defaultdict(list)
        self.places: dict[str, list[Placed]] = defaultdict(list)
        self.leads: list[Led] = []
        self._file = io.StringIO() if path is None else path.open(encoding="utf-8")
        self._rest = ""
        index = {name: number for number, name in enumerate(mission.names)}
        self.edges = tuple(
            (index[name], index[other]) for name in mission.names for other in mission.robots[name].neighbours
        )

    def close(self) -> None:
        """No more is read."""
        self._file.close()

    def read_on(self) -> None:
        """Take what was written since the last time."""
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        for line in lines:
            self.process_line(json.loads(line))

    def process_line(self, line: Sequence[Any]) -> None:
        """Take one line of a witness."""
        kind, at, *rest = line
        if kind == "command":
            self.commands[rest[0]].append(Commanded(at, rest[1], rest[2]))
        elif kind == "truth":
            name, x, y, heading = rest
            offset = self.mission.robots[name].control_point_offset
            self.places[name].append(Placed(at, complex(x, y) + offset * np.exp(1j * heading)))
        elif kind == "lead" and (attachment := PositionAttachment.model_validate(rest[2])).order is not None:
            self.leads.append(Led.of(at, complex(*rest[:2]), attachment, attachment.order, self.mission))

    def forget(self, before: float) -> None:
        """Let go of what is older [s, monotonic], but for the last of it."""
        every: list[list[Any]] = [*self.commands.values(), *self.places.values(), self.leads]
        for rows in every:
            del rows[: max(0, _first(rows, before) - 1)]

    @property
    def now(self) -> float:
        """Up to when all robots' places are known [s, monotonic]; minus infinity before that."""
        followers = self.mission.followers
        if not self.leads or not all(self.places.get(name) for name in followers):
            return -np.inf
        return min(self.places[name][-1].at for name in followers)

    def errors(self, times: Floats) -> Floats:
        """Formation error at each of `times`: over all edges, in the shape in force then [m].

        A silent leader is where it was last.
        """
        points, slots = self._points(times)
        total = np.zeros(len(times))
        for i, j in self.edges:
            total += np.abs(points[j] - points[i] - slots[j] + slots[i])
        return total

    def distances(self, times: Floats) -> Floats:
        """The least distance of two followers' control points at each of `times` [m]."""
        points, _ = self._points(times)
        followers = points[1:]
        apart = np.abs(followers[:, None] - followers[None, :])
        apart[np.diag_indices(len(followers))] = np.inf
        return np.asarray(apart.min(axis=(0, 1)))

    def _points(self, times: Floats) -> tuple[Points, Points]:
        """Control points and slots over ``mission.names``; shape (n, times)."""
        leads = sorted(self.leads)
        at = np.array([one.at for one in leads])
        points = [_between(times, at, np.array([one.point for one in leads]))]
        for name in self.mission.followers:
            moments, places = (np.array(column) for column in zip(*self.places[name], strict=True))
            points.append(_between(times, moments, places))
        result = np.array([one.slots for one in leads]).T
        return np.array(points), np.array([_between(times, at, row) for row in result])


def window(rows: Sequence[T], since: float, until: float = np.inf) -> Sequence[T]:
    """Those of a time [s, monotonic]."""
    return rows[_first(rows, since) : _first(rows, until)]


def _first(rows: Sequence[Any], since: float) -> int:
    return bisect_left(rows, since, key=lambda row: row.at)


def _between(times: Floats, at: Floats, values: Any) -> Points:
    order = np.argsort(at, kind="stable")
    at, values = at[order], values[order]
    return np.asarray(np.interp(times, at, values.real) + 1j * np.interp(times, at, values.imag))
