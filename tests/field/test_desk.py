"""The desk of a secured team: the monitor's certificate permits watching, the operator's permits orders."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.field.team import VICTIM, Team, driving
from tests.support.namespaces import Running, until

pytestmark = [pytest.mark.namespaces, pytest.mark.processes, pytest.mark.timeout(300)]
HERE = {"leader", "robot1", VICTIM}
ALL = HERE | {"robot3"}
ORDER = """
import json, sys, urllib.error, urllib.request
address, token, body = sys.argv[1:]
headers = {"authorization": "Bearer " + token, "content-type": "application/json"}
request = urllib.request.Request(address + "api/order", body.encode(), headers)
try:
    with urllib.request.urlopen(request, timeout=20.0) as answer:
        print(json.dumps([answer.status, json.load(answer)]))
except urllib.error.HTTPError as error:
    print(json.dumps([error.code, {}]))
"""


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("team")) as team:
        yield team


class Answer(NamedTuple):
    status: int
    report: dict[str, Any]

    @property
    def obeyed(self) -> set[str]:
        return {one["robot"] for one in self.report["acknowledged"]}


class Page:
    """The live page of a monitor at the desk."""

    def __init__(self, team: Team, monitor: Running) -> None:
        self._team, self._monitor = team, monitor
        self.address, _, self.token = monitor.event("ready")["page"].partition("#token=")

    def order(self, do: str, token: str = "") -> Answer:
        """Send an operator request to the page, from the desk."""
        body = json.dumps({"do": do})
        command = (sys.executable, "-c", ORDER, self.address, token or self.token, body)
        return Answer(*json.loads(self._team.desk_computer.run(*command).stdout))

    def links(self) -> int:
        """Number of links of the monitor and of its page's operator with robots."""
        return len(self._team.desk_computer.links(self._monitor.pid))

    def receives_all(self) -> bool:
        result = self._monitor.events("snapshot")
        return bool(result) and all(result[-1]["robots"][name]["state"] == "run" for name in HERE)


@contextmanager
def monitored(team: Team, *flags: str) -> Iterator[Page]:
    watching = ("-c", str(team.desk.file("monitor")), "--no-record", "--snapshots", "--page", "127.0.0.1:0")
    monitor = team.desk_computer.start(*team.formation("monitor", *watching, "--control", *flags))
    page = Page(team, monitor)
    until(page.receives_all, what="the monitor receives all robots")
    try:
        yield page
    finally:
        assert monitor.stop() == 0


def as_operator(team: Team) -> tuple[str, str]:
    return "--control-config", str(team.desk.file("operator"))


def stands(team: Team) -> bool:
    return all(command[1:] == (0.0, 0.0) for command in team.commands(since=time.monotonic() - 0.5))


def drives_on(team: Team, since: float) -> None:
    """Check by status and commands that the victim drives on and was not stopped."""
    until(lambda: len(team.states(since)) > 0, what="a status of the victim")
    until(team.settled, 60.0, "the victim drives straight")
    assert "stop" not in team.states(since)


def test_watch_needs_monitor_certificate(team: Team) -> None:
    def watched(*flags: str) -> tuple[int, str, str]:
        """Run `formation watch --once`: exit code, output, errors."""
        done = team.desk_computer.run(*team.formation("watch", "--once", *flags))
        return done.returncode, done.stdout, done.stderr

    code, out, errors = watched("--json", "-c", str(team.desk.file("monitor")))
    states = {name: robot["state"] for name, robot in json.loads(out)["robots"].items()}
    assert set(states) == ALL, errors
    assert states.pop("robot3") == "unseen"  # it is absent
    assert set(states.values()) <= {"run", "hold"}  # a short hold, if this machine was busy
    assert code == 1

    code, out, errors = watched()
    assert (code, out) == (1, "")
    assert "no process answers at tls/" in errors
    assert "-c FILE" in errors
    assert team.states(0.0) - {"waiting", "hold"} == {"run"}  # watching disturbed no robot


def test_order_without_certificate_explains_missing_option(team: Team) -> None:
    done = team.desk_computer.run(*team.formation("order", "release", "--timeout", "1.5", "--json"))
    assert done.returncode == 1
    assert set(json.loads(done.stdout.splitlines()[-1])["missing"]) == ALL
    assert "-c FILE" in done.stderr


def test_operator_certificate_lets_page_stop_and_release_team(team: Team) -> None:
    before = team.refused()
    with monitored(team, *as_operator(team)) as page:
        until(lambda: page.links() == 2 * len(HERE), what="monitor and operator are linked with all")
        since = time.monotonic()
        stop = page.order("stop")
        assert (stop.status, stop.obeyed, stop.report["missing"]) == (200, HERE, ["robot3"])
        until(lambda: "stop" in team.states(since), what="the victim reports stop")
        until(lambda: stands(team), what="the victim stands")
        until(lambda: page.order("release").status == 200, what="a release is accepted")
        until(lambda: page.order("run").status == 200, what="a run is accepted")
        until(team.settled, 60.0, "the victim drives straight again")
    assert team.refused() == before


def test_monitor_certificate_stops_no_robot_and_explains_why(team: Team) -> None:
    with monitored(team) as page:
        since, stop = time.monotonic(), page.order("stop")
        assert (stop.status, stop.obeyed, set(stop.report["missing"])) == (200, set(), ALL)
        assert "--control-config FILE" in stop.report["why"]
        drives_on(team, since)


def test_robot_certificate_stops_no_robot_and_explains_why(team: Team, tmp_path: Path) -> None:
    text = team.desk.file("operator").read_text()
    thief = tmp_path / "thief.json5"
    thief.write_text(text.replace(f"{team.desk.folder}/operator/", f"{team.desk.folder}/robot1/"))
    with monitored(team, "--control-config", str(thief)) as page:
        since, stop = time.monotonic(), page.order("stop")
        assert (stop.status, stop.obeyed) == (200, set())
        assert "is that certificate in --control-config?" in stop.report["why"]
        drives_on(team, since)
