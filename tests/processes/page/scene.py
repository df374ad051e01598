"""A simulated fleet of N robots without any process: the messages that a page receives of it."""

from __future__ import annotations

import cmath
import math
import random
from typing import Any

from formation.monitor.web.frames import FIELDS

EPOCH = 1.8e9
"""System clock when the scene begins [s]."""
PERIOD = 0.1
"""Between two frames [s]."""
OFFSET, MAX_SPEED, MAX_TURN_RATE = 0.2, 1.5, 1.5
LEADER_VELOCITY = 0.2 * cmath.rect(1.0, math.radians(30.0))
"""Velocity of the leader [m/s]."""
GAIN = 1.0
"""[1/s]"""
LOST = 1.0
"""[s]"""


class Scene:
    """Unicycles that drive from random starts to their slots behind a leader; robots may be silent."""

    def __init__(
        self, count: int, *, live: bool = True, control: bool = False, standbys: tuple[str, ...] = ()
    ) -> None:
        self.names = [f"robot{number + 1}" for number in range(count)]
        self.time = 0.0
        self.silent: dict[str, float] = {}
        """Time from which a robot is silent [s]."""
        self.state = dict.fromkeys(self.names, ("run", "in formation control"))
        self.unavailable: set[str] = set()
        """The robots that are unavailable."""
        self.avoiding: dict[str, str] = {}
        """Words for what limits a robot's commands, by robot."""
        self.fallback: dict[str, str] = {}
        """Fallback neighbour that a robot follows, by robot."""
        self.wedge, self.rotation, self.scale = 0.0, 0.0, 1.0
        """Progress of the shape transition [share], rotation [rad] and scale of the placed shape."""
        self.leads = self.names[0]
        self.candidates = (
            {name: ["standby", "", 0.2] for name in (self.names[0], *standbys)} if standbys else {}
        )
        """State, reason and age of each candidate."""
        self.waits = ""
        """Robots for which the leader waits."""
        self.replay: dict[str, Any] = {"speed": 1.0, "paused": False}
        """Fields of a frame about the replay, without its times."""
        self.posts: list[list[float]] = []
        self.walls: list[list[float]] = []
        """Posts as x, y and radius, walls as their two ends [m]."""
        self._live, self._control = live, control
        self._drawn = _hexagon() if count == 6 else _block(count)
        self._slots = self._drawn
        draw = random.Random(count)
        spread = 2.0 if count == 6 else 3.0
        self._place = [slot + complex(draw.gauss(0, spread), draw.gauss(0, spread)) for slot in self._drawn]
        self._place[0] = 0j
        self._heading = [cmath.rect(1.0, draw.uniform(-math.pi, math.pi)) for _ in self.names]
        self._guess = [draw.uniform(-1.0, 1.0) for _ in self.names]
        self._command = [(0.0, 0.0)] * count

    @property
    def now(self) -> float:
        """System clock [s]."""
        return EPOCH + self.time

    def _placed_shape(self) -> list[complex]:
        """Slots of the placed shape, relative to the leader [m]."""
        turned = self.scale * cmath.rect(1.0, self.rotation)
        row = [complex(-0.7 * number, 0.7 * number * (-1) ** number) for number in range(len(self.names))]
        return [
            turned * (slot + self.wedge * (new - slot)) for slot, new in zip(self._drawn, row, strict=True)
        ]

    @property
    def edges(self) -> list[tuple[int, int]]:
        """Each robot measures one or two robots before it."""
        wide = 1 if len(self.names) == 6 else math.ceil(math.sqrt(len(self.names)))
        return [(i, j) for i in range(1, len(self.names)) for j in {i - 1, max(i - 1 - wide, 0)}]

    def hello(self) -> dict[str, Any]:
        """Return the first message of a connection, without what a Source adds."""
        robots = [
            {
                "name": name, "leader": name == self.names[0], "max_speed": MAX_SPEED,
                "max_turn_rate": MAX_TURN_RATE, "offset": OFFSET if number else 0.0, "rate": 20.0,
            }
            for number, name in enumerate(self.names)
        ]  # fmt: skip
        return {
            "live": self._live, "mission": f"{len(self.names)}-robots", "law": "field", "settled": 0.05,
            "control": self._control, "version": "0.1.0", "robots": robots, "edges": self.edges,
            "posts": self.posts, "walls": self.walls,
            "shapes": {"hexagon": [], "wedge": []}, "candidates": list(self.candidates),
            "fields": list(FIELDS),
        }  # fmt: skip

    def step(self) -> dict[str, Any]:
        """Drive for `PERIOD`; return the frame after it."""
        self._slots = self._placed_shape()
        for _ in range(5):
            self._drive(PERIOD / 5)
        self.time += PERIOD
        return self.frame()

    def frame(self) -> dict[str, Any]:
        leader = self._place[0]
        points = [self._point(n) for n in range(len(self.names))]
        wrong = [
            None if self._is_silent(i) or self._is_silent(j)
            else round(abs(points[j] - points[i] - (self._slots[j] - self._slots[i])), 4)
            for i, j in self.edges
        ]  # fmt: skip
        rows = [self._row(n, leader + self._slots[n], wrong) for n in range(len(self.names))]
        known = [error for error in wrong if error is not None]
        total = sum(known) if len(known) == len(wrong) else None
        return {
            **self._known_edges(known, len(wrong)),
            "t": self.now, "elapsed": self.time, "error": total, "true": total,
            "settled_at": 9.3 if total is not None and total < 0.05 else None,
            "converged": total is not None and total < 0.05, "mode": "run",
            "shape": "wedge" if self.wedge else "hexagon",
            "missed": 3, "rejected": 0,
            "recording": {
                "path": "recordings/scene.mcap", "bytes": int(52e3 * self.time), "seconds": self.time,
                "failure": None,
            },
            "r": rows, "e": wrong,
            **self._optional_fields(),
            **({} if self._live else {"replay": self._replay()}),
        }  # fmt: skip

    def _known_edges(self, known: list[float], edges: int) -> dict[str, Any]:
        """Error over the known edges, if some are unknown."""
        if len(known) == edges or not known:
            return {}
        gone = ", ".join(f"{name} silent for 3 s" for name in self.silent)
        words = f"{len(known)} of {edges} edges; {edges - len(known)} unknown ({gone})"
        stands = sum(known) < 0.05
        return {"known": [round(sum(known), 4), len(known), edges, words, 9.3 if stands else None, stands]}

    def _optional_fields(self) -> dict[str, Any]:
        """Fields that a frame has only if they have a value."""
        found: dict[str, Any] = {"waits": self.waits} if self.waits else {}
        if 0.0 < self.wedge < 1.0:
            found |= {"forming": True}
        if self.rotation or self.scale != 1.0:
            found |= {"rotation": self.rotation, "scale": self.scale}
        if self.candidates:
            rows = [["leads" if n == self.leads else one[0], *one[1:]] for n, one in self.candidates.items()]
            found |= {"leads": self.leads, "since": EPOCH + 2.0, "c": rows}
        return found

    def _replay(self) -> dict[str, Any]:
        return {"t": self.now, "start": EPOCH, "end": EPOCH + 30.0, **self.replay}

    def _is_silent(self, n: int) -> bool:
        return self.time - self.silent.get(self.names[n], math.inf) > LOST

    def _point(self, n: int) -> complex:
        return self._place[n] + (OFFSET * self._heading[n] if n else 0j)

    def _drive(self, step: float) -> None:
        self._place[0] += LEADER_VELOCITY * step
        self._heading[0] = cmath.rect(1.0, cmath.phase(LEADER_VELOCITY))
        self._guess = [guess * math.exp(-0.8 * step) for guess in self._guess]
        for n in range(1, len(self.names)):
            if self.names[n] in self.silent or self.state[self.names[n]][0] != "run":
                self._command[n] = (0.0, 0.0)
                continue
            wanted = LEADER_VELOCITY + GAIN * (self._place[0] + self._slots[n] - self._point(n))
            inside = wanted / self._heading[n]
            speed = max(-MAX_SPEED, min(MAX_SPEED, inside.real))
            turn = max(-MAX_TURN_RATE, min(MAX_TURN_RATE, inside.imag / OFFSET))
            self._command[n] = (speed, turn)
            self._place[n] += speed * self._heading[n] * step
            self._heading[n] *= cmath.rect(1.0, turn * step)

    def _row(self, n: int, slot: complex, wrong: list[float | None]) -> list[Any]:
        name = self.names[n]
        age = 0.02 + 0.03 * ((n * 7) % 5) / 5 + max(0.0, self.time - self.silent.get(name, math.inf))
        gone = self._is_silent(n)
        place, point = self._place[n], self._point(n)
        own = [error for (i, _), error in zip(self.edges, wrong, strict=True) if i == n]
        error = None if not own or None in own else round(sum(e for e in own if e is not None), 4)
        speed, turn = self._command[n] if n else (abs(LEADER_VELOCITY), 0.0)
        state, reason = ("silent", f"no status for {age:.1f} s") if gone else self.state[name]
        loss = 0.04 if n % 9 == 4 else 0.0
        health = 0.0 if gone else 1.0 - 8 * loss if state == "run" else 0.5
        why = "" if health == 1.0 else f"loses {loss:.0%} of its positions" if loss else reason
        where = [None] * 5 if gone else _pose_fields(place, cmath.phase(self._heading[n]), point)
        guess = self._guess[n] if n else 0.0
        if not gone:
            where[2] = round(cmath.phase(self._heading[n] * cmath.rect(1.0, guess)), 3)
        return [
            *where, round(slot.real, 3), round(slot.imag, 3), error,
            *((None,) * 4 if gone else _command_fields(speed, turn)),
            round(age, 3), None if gone else 20.0, loss, health, state, reason,
            round(place.real, 3), round(place.imag, 3), round(guess, 3), why,
            int(name in self.unavailable), self.fallback.get(name, ""), self.avoiding.get(name, ""),
        ]  # fmt: skip


def _command_fields(speed: float, turn: float) -> list[float]:
    return [round(one, 3) for one in (speed, turn, abs(speed) / MAX_SPEED, abs(turn) / MAX_TURN_RATE)]


def _pose_fields(place: complex, heading: float, point: complex) -> list[Any]:
    return [round(value, 3) for value in (place.real, place.imag, heading, point.real, point.imag)]


def _hexagon() -> list[complex]:
    return [0j, -0.5 + 0.866j, -1.5 + 0.866j, -2 + 0j, -1.5 - 0.866j, -0.5 - 0.866j]


def _block(count: int) -> list[complex]:
    """Rows behind the leader, a metre apart."""
    wide = math.ceil(math.sqrt(count))
    return [complex(-(n // wide), -(n % wide) + wide // 2) for n in range(count)]


def event(number: int, at: float, kind: str, robot: str, text: str, level: int = 20) -> dict[str, Any]:
    """An event as a page receives it; `at` is on the scene's clock [s]."""
    return {"n": number, "at": EPOCH + at, "level": level, "robot": robot, "kind": kind, "text": text}
