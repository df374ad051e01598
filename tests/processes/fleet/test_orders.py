"""Orders to real processes: answers before and after the leader is killed, and their recording."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from formation.deploy.testing.pytest_plugin import MakeProcesses
from formation.mission.route import Straight
from formation.monitor.recording.reader import read
from formation.protocol.outcome import Outcome
from formation.ros2.messages import Diagnostics, decode
from formation.topics import STATUS
from tests.support.missions import row_of_three

pytestmark = pytest.mark.processes
MISSION = row_of_three(
    "ordered", rate=10, speed=0.05, takeover="takeover = 1.0",
    tables="[standbys.spare]\n[shapes.apart]\na = [-1.0, 0.5]\nb = [-2.0, -0.5]\nc = [-3.0, 0.5]",
)  # fmt: skip
SLACK = 2.0
"""Longest time until a status is recorded, also on a busy machine [s]."""


def obeying(outcome: Outcome) -> set[str]:
    return {one["robot"] for one in outcome.report()["acknowledged"]}


def test_orders_are_answered_by_the_next_leader_and_recorded(process_fleet: MakeProcesses) -> None:
    fleet = process_fleet(MISSION)
    robots = set(fleet.mission.followers)
    fleet.run_until_settled()
    stop = fleet.order("stop")
    first = stop.leader
    assert first is not None
    (second,) = {"led", "spare"} - {first}  # on a busy machine the standby may have led first
    assert (stop.obeyed, obeying(stop)) == (True, {first, *robots})
    given = [
        stop,
        refused := fleet.order("run"),
        *(fleet.order(do) for do in ("release", "hold", "run")),
        fleet.order("shape", shape="apart"),
        fleet.order("rotate", degrees=-30.0),
        fleet.order("scale", factor=1.5),
        fleet.order("speed", speed=0.05, degrees=90.0),
        fleet.order("route", legs=(Straight(speed=0.05, heading_deg=10.0),)),
    ]
    assert set(refused.refused) == {first, *robots}  # all are stopped
    assert [one.obeyed for one in given] == [one is not refused for one in given], given
    fleet.run(SLACK)
    told = [one for one in fleet.events if (one.kind, one.robot) == ("requested", first)]
    fleet.kill(first)
    stop = fleet.order("stop")  # repeated until the standby leads
    assert (stop.leader, stop.missing, obeying(stop)) == (second, [], {second, *robots})
    assert re.search(rf"{first} +no answer; {second} leads", stop.words())
    assert set(fleet.order("run").refused) == {second, *robots}
    for do, what in (("release", {}), ("rotate", {"degrees": 30.0}), ("run", {})):
        outcome = fleet.order(do, **what)
        assert (outcome.obeyed, outcome.leader) == (True, second), outcome.words()
    fleet.close()
    assert len(told) == len(given)
    requests: dict[str, tuple[float, dict[str, Any]]] = {}
    for message in read(fleet.recording).messages():
        if message.sample.key == STATUS.key(first):
            for status in decode(Diagnostics, message.sample.payload).statuses:
                for one in json.loads(status.values.get("requests", "[]")):
                    requests.setdefault(one["id"], (message.wall, one))
    assert list(requests) == [outcome.request.id for outcome in given]
    for outcome, (wall, one) in zip(given, requests.values(), strict=True):
        order = outcome.report()
        assert order == {**order, **{name: one[name] for name in one.keys() - {"age", "ok", "reason"}}}
        assert one["ok"] == (outcome is not refused)
        assert order["at"] <= wall <= order["at"] + 1e-3 * outcome.answers[first].ms + SLACK
