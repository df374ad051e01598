"""Orders from the page to six real robots' agents: who acknowledges, and what robots then really do."""

from __future__ import annotations

import json
import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from tests.processes.fleet.driven import SIX, Page, Team, driving, under_way
from tests.support.child import PATIENCE

pytestmark = [pytest.mark.processes, pytest.mark.timeout(240)]
EVERYBODY = set(SIX.names)


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("page") / "run.mcap", "--control") as team:
        yield team


@pytest.fixture
def page(team: Team) -> Iterator[Page]:
    """The page of a team that drives, before the test and after it."""
    team.page.until(lambda _: team.witness.drive())
    yield team.page
    for do in ("release", "run"):
        team.page.until_taken(do)
    team.page.until(under_way)


def obeying(report: dict[str, Any]) -> set[str]:
    """Who acknowledged an order."""
    return {one["robot"] for one in report["acknowledged"]}


def states(page: Page) -> set[str]:
    """What the robots say that they do."""
    return {one["state"] for one in page.snapshot()["robots"].values()}


def noted(page: Page, words: str, since: float) -> list[str]:
    """What the events since then [s, system clock] say of orders, with these words in it.

    Whoever gave an order has its report sooner: an event joins the others when the monitor looks next.
    """
    found: list[str] = []

    def looked(_: dict[str, Any]) -> bool:
        reported = [one for one in page.events() if one["kind"] == "operator" and one["at"] >= since]
        found[:] = [one["text"] for one in reported if words in one["text"]]
        return bool(found)

    page.until(looked)
    return found


def test_stop_is_acknowledged_and_lasts_until_release(team: Team, page: Page) -> None:
    begun = time.time()
    report = page.obeyed("stop")
    assert obeying(report) == EVERYBODY
    assert {one["mode"] for one in report["acknowledged"]} == {"stop"}
    page.until(lambda seen: all(one["state"] == "stop" for one in seen["robots"].values()))
    page.until(lambda _: team.witness.stand())
    refused = page.until_taken("run")["refused"]
    assert {one["robot"] for one in refused} == EVERYBODY
    assert {one["reason"] for one in refused} == {"stopped: release it first"}
    assert team.witness.stand()
    page.until_taken("release")
    page.until(lambda seen: all(one["state"] == "hold" for one in seen["robots"].values()))
    assert team.witness.stand()
    page.until_taken("run")
    page.until(lambda _: team.witness.drive())
    (result,) = noted(page, "stop: 6 of 6 obey", begun)
    assert result.startswith("stop: 6 of 6 obey, slowest ")


def test_held_robots_stand_and_run_when_they_are_told_to(team: Team, page: Page) -> None:
    assert obeying(page.obeyed("hold")) == EVERYBODY
    page.until(lambda seen: seen["mode"] == "hold" and team.witness.stand())
    page.until_taken("run")
    page.until(lambda _: team.witness.drive())


def test_shape_requests_work_from_command_line_and_page(team: Team, page: Page) -> None:
    for shape, order in (("wedge", typed), ("hexagon", clicked)):
        report = order(team, shape)
        assert (report["do"], report["shape"], report["missing"]) == ("shape", shape, [])
        assert obeying(report) == {"robot1"}
        changed = page.until(lambda seen, shape=shape: seen["shape"] == shape)  # type: ignore[misc]
        assert not changed["converged"]  # the slots have only begun to move
        page.until(lambda seen: bool(seen["converged"]), patience=80.0)
        page.until(lambda _: team.witness.drive())


def typed(team: Team, shape: str) -> dict[str, Any]:
    where = ("-e", team.where.agents[SIX.leader])
    command = [
        sys.executable,
        "-m",
        "formation.deploy",
        "order",
        "six_robots",
        "shape",
        shape,
        "--json",
        *where,
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    report: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return report


def clicked(team: Team, shape: str) -> dict[str, Any]:
    return team.page.obeyed("shape", shape=shape)


def test_wrong_token_stops_no_robot_and_reveals_nothing(team: Team, page: Page) -> None:
    for token in ("", "x", page.token[:-1], page.token + "x", secrets.token_urlsafe(32)):
        answer = page.order("stop", token=token)
        assert answer.status_code == 401
        assert page.token not in answer.text
    assert not team.witness.stand()
    assert "stop" not in states(page)


def test_unresponsive_robot_is_named_and_stops_through_neighbours(team: Team, page: Page) -> None:
    hung, begun = team.children["agent robot6"].pid, time.time()
    os.kill(hung, signal.SIGSTOP)
    try:
        report = page.order("stop").json()
    finally:
        os.kill(hung, signal.SIGCONT)
    assert report["missing"] == ["robot6"]
    assert obeying(report) == EVERYBODY - {"robot6"}
    (result,) = noted(page, "no answer", begun)
    assert result.endswith("; no answer from robot6; robot6 may still drive: use the robot's own switch")
    page.until(lambda seen: seen["robots"]["robot6"]["state"] == "stop" and team.witness.stand())


def test_a_click_that_is_sent_twice_takes_effect_once(team: Team, page: Page) -> None:
    page.obeyed("stop")
    page.until_taken("release", click="c")
    page.until_taken("run")
    page.until(lambda _: team.witness.drive())
    page.obeyed("stop")
    page.until(lambda _: team.witness.stand())
    again = page.order("release", click="c")  # as a browser may, whose line broke
    assert again.is_success
    assert team.witness.stand()
    assert states(page) == {"stop"}
    page.until_taken("release")


def test_stop_wins_over_simultaneous_clicks(team: Team, page: Page) -> None:
    seen = time.time()  # what all of them show
    with ThreadPoolExecutor(12) as pages:
        wishes = ("run", "release", "hold", "run", "release")
        others = [pages.submit(page.order, do, seen=seen) for do in wishes]
        stop = pages.submit(page.obeyed, "stop")
        others += [pages.submit(page.order, do, seen=seen) for do in wishes]
        assert obeying(stop.result()) == EVERYBODY
        assert {one.result().status_code for one in others} <= {200, 409}
    page.until(lambda _: team.witness.stand() and states(page) == {"stop"})
