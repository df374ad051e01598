"""Ports of this machine for a mission's processes, held until the processes listen on them.

A port is held by a socket that is bound and does not listen. With SO_REUSEADDR on both sides Linux lets the
intended process listen on it all the same; a request for any free port never gets it.
"""

from __future__ import annotations

import re
import socket
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from typing import Self

from formation.mission.model import Mission
from formation.transport import wiring
from formation.transport.wiring import Endpoints

HOST = "127.0.0.1"


class Ports:
    """Endpoints of every process of a mission on this machine, held while the context lasts.

    Agents get the mission's own endpoints if those are plain TCP of this machine and all free, so that
    `formation order` finds them without flags; else others. An endpoint that the mission names for a robot
    belongs to its ROS 2 router, so no simulated robot uses it: those get the usual ports, or others.
    """

    def __init__(self, mission: Mission) -> None:
        self._held = ExitStack()
        wanted = wiring.endpoints(mission)
        named = any(mission.robots[name].robot_endpoint for name in wanted.robots)
        try:
            self.as_in_mission = self._hold_all(wanted.agents.values())
            """Whether agents and leader listen at the mission's endpoints."""
            usual = not named and self._hold_all(wanted.robots.values())
            self.endpoints = Endpoints(
                wanted.agents if self.as_in_mission else {name: self._any() for name in wanted.agents},
                wanted.robots if usual else {name: self._any() for name in wanted.robots},
            )
        except OSError:
            self._held.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def _hold_all(self, endpoints: Iterable[str]) -> bool:
        """Hold every endpoint, or none if one is not available."""
        with ExitStack() as held:
            for endpoint in endpoints:
                local = re.fullmatch(rf"tcp/({re.escape(HOST)}|localhost):(\d+)", endpoint)
                try:
                    if local is None or not _hold(int(local[2]), held):
                        return False
                except (OSError, OverflowError):  # it is taken, or no port at all
                    return False
            self._held.push(held.pop_all())
        return True

    def _any(self) -> str:
        """Return an endpoint with a free port."""
        holder = self._held.enter_context(socket.socket())
        holder.bind((HOST, 0))
        port = holder.getsockname()[1]
        holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sys.platform != "linux":  # elsewhere a bound port is taken, reusable or not
            holder.close()
        return f"tcp/{HOST}:{port}"


def _hold(port: int, held: ExitStack) -> bool:
    """Hold a given port, even if connections of the last run linger. OSError if it is taken."""
    if sys.platform != "linux":
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
        return True
    # Two launchers that start at once could both bind, since neither listens. An abstract name has one owner.
    held.enter_context(socket.socket(socket.AF_UNIX)).bind(f"\0formation-run/{port}")
    holder = held.enter_context(socket.socket())
    holder.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    holder.bind((HOST, port))
    return True
