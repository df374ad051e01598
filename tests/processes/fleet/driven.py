"""Six robots that drive in real processes, an operator's page, and a witness of where robots really are."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any

import httpx

from formation.deploy.local.plan import programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.ros2.messages import Pose, decode
from formation.topics import GROUND_TRUTH
from formation.transport.mailbox import Mailbox
from formation.transport.robot_bus import RobotBuses
from formation.transport.wiring import Endpoints
from tests.support.child import PATIENCE, Child, started

SIX = load("six_robots")
STANDING = 1e-4
"""A robot that moves less between two looks stands [m]."""


class Page:
    """What a browser does for an operator, without the browser."""

    def __init__(self, invitation: str) -> None:
        self.address, _, self.token = invitation.partition("#token=")

    def order(self, do: str, *, token: str | None = None, **more: Any) -> httpx.Response:
        """Ask for it, by default with the page's own token."""
        headers = {"authorization": f"Bearer {self.token if token is None else token}".strip()}
        url = f"{self.address}api/order"
        return httpx.post(url, json={"do": do, **more}, headers=headers, timeout=PATIENCE)

    def obeyed(self, do: str, **more: Any) -> dict[str, Any]:
        """The report of an order that everybody asked obeys."""
        answer = self.order(do, **more)
        assert answer.status_code == 200, answer.text
        report: dict[str, Any] = answer.json()
        assert (report["missing"], report["refused"]) == ([], []), report
        return report

    def until_taken(self, do: str, **more: Any) -> dict[str, Any]:
        """The report of an order, asked for until nothing that was ordered just before overrules it."""
        deadline = time.monotonic() + PATIENCE
        while (answer := self.order(do, **more)).status_code == 409:
            assert time.monotonic() < deadline, answer.text
            time.sleep(0.1)
        assert answer.status_code == 200, answer.text
        report: dict[str, Any] = answer.json()
        return report

    def snapshot(self) -> dict[str, Any]:
        """What the monitor knows right now."""
        found: dict[str, Any] = httpx.get(f"{self.address}api/snapshot", timeout=PATIENCE).json()
        return found

    def events(self) -> list[dict[str, Any]]:
        """What has happened so far."""
        with httpx.stream("GET", f"{self.address}stream", timeout=PATIENCE) as stream:
            for line in stream.iter_lines():
                if line.startswith("data:"):
                    hello = json.loads(line.removeprefix("data:"))
                    return list(hello["events"])
        raise AssertionError("the stream ended without a greeting")

    def until(self, what: Callable[[dict[str, Any]], bool], patience: float = PATIENCE) -> dict[str, Any]:
        """The first snapshot of which `what` is true."""
        deadline = time.monotonic() + patience
        while not what(snapshot := self.snapshot()):
            assert time.monotonic() < deadline, f"the last that was seen: {snapshot}"
            time.sleep(0.1)
        return snapshot


class Witness:
    """Where robots really are, from the robots themselves."""

    def __init__(self, where: Endpoints, stack: ExitStack) -> None:
        self._box = Mailbox()
        robots = stack.enter_context(closing(RobotBuses(SIX, where.robots, self._box, node="witness")))
        for name in SIX.followers:
            robots.subscribe(GROUND_TRUTH, GROUND_TRUTH.key(name))

    def moved(self, seconds: float = 0.5) -> dict[str, float]:
        """How far each robot is from where it was so long ago [m]."""
        before = self._poses()
        time.sleep(seconds)
        after = self._poses()
        return {name: abs(after[name].position - before[name].position) for name in SIX.followers}

    def stand(self) -> bool:
        """Whether nobody moves."""
        return max(self.moved().values()) < STANDING

    def drive(self) -> bool:
        """Whether everybody moves."""
        return min(self.moved().values()) > 100 * STANDING

    def _poses(self) -> dict[str, Pose]:
        self._box.drain()
        poses: dict[str, Pose] = {}
        while len(poses) < len(SIX.followers):
            assert self._box.wait(PATIENCE), "the robots say nothing"
            for sample in self._box.drain():
                poses[sample.key.partition("/")[0]] = decode(Pose, sample.payload)
        return poses


class Team:
    """All of it."""

    def __init__(self, where: Endpoints, children: dict[str, Child], page: Page, witness: Witness) -> None:
        self.where, self.children, self.page, self.witness = where, children, page, witness


def under_way(snapshot: dict[str, Any]) -> bool:
    """Whether everybody says that it runs."""
    return {one["state"] for one in snapshot["robots"].values()} == {"run"}


@contextmanager
def driving(record: Path, *flags: str) -> Iterator[Team]:
    """Six robots under way; the monitor's page is served with `flags`."""
    with ExitStack() as stack:
        where = stack.enter_context(Ports(SIX)).endpoints
        page = ("--page", "127.0.0.1:0", *flags)
        children, ready = {}, {}
        for program in programs(
            SIX, "six_robots", where, parent=os.getpid(), record=record, page=page, patience=PATIENCE
        ):
            module, *arguments = program.argv[program.argv.index("-m") + 1 :]
            children[program.name] = stack.enter_context(started(module, *arguments))
        for name, child in children.items():
            ready[name] = child.event("ready")
        team = Team(where, children, Page(ready["monitor"]["page"]), Witness(where, stack))
        team.page.until(under_way)
        yield team
