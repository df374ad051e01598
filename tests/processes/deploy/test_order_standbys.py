"""Orders to a team with a standby, before and after its leader is killed."""

from __future__ import annotations

import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.processes.fleet.twenty import LEADER, Team, twenty
from tests.support.child import free_endpoint

pytestmark = pytest.mark.processes
ROBOTS = {"robot1", "robot2", "robot3"}


@pytest.fixture
def team(tmp_path: Path) -> Iterator[Team]:
    with twenty(tmp_path, len(ROBOTS), f'[standbys.spare]\nendpoint = "{free_endpoint()}"\n') as team:
        yield team


def test_standby_answers_orders_after_leader_is_killed(team: Team) -> None:
    given = team.order("run")  # answered once a process leads: on a busy machine that may be the standby
    first = given.report["leader"]
    (second,) = {LEADER, "spare"} - {first}
    given = team.order("stop")
    assert (given.code, given.report["leader"]) == (0, first), given.words
    assert {one["robot"] for one in given.report["acknowledged"]} == {first, *ROBOTS}
    assert given.report["standby"] in ([], [second])  # the standby has 0.1 s to answer

    team.children[first].signal(signal.SIGKILL)
    given = team.order("stop")  # repeated until the standby leads
    assert (given.code, given.report["leader"], given.report["missing"]) == (0, second, []), given.words
    assert {one["robot"] for one in given.report["acknowledged"]} == {second, *ROBOTS}
    assert re.search(rf"{first} +no answer; {second} leads", given.words)

    refused = team.order("run")
    assert {one["robot"] for one in refused.report["refused"]} == {second, *ROBOTS}  # all robots are stopped
    for words in ("release", "hold", "rotate 30", "run"):
        given = team.order(*words.split())
        assert (given.code, given.report["leader"]) == (0, second), given.words
