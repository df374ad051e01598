"""Ballots are received only from candidates, by the name in their certificates."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from formation.topics import BALLOT, ORDER, POSITION, ROUTE, STATUS
from tests.field.missions import in_the_field
from tests.field.sessions import Sessions, prepared
from tests.support.child import free_endpoint
from tests.support.namespaces import PATIENCE, until

pytestmark = pytest.mark.processes


@pytest.fixture
def sessions(tmp_path: Path) -> Iterator[Sessions]:
    port = free_endpoint().rpartition(":")[2]
    mission = in_the_field("patrol", lambda i: f"tls/127.0.0.{i + 1}:{port}", team="reds")
    with ExitStack() as stack:
        yield Sessions(prepared(mission, tmp_path / "secrets"), stack)


def test_standby_exchanges_ballots_routes_and_positions_with_team(sessions: Sessions) -> None:
    robot3, leader, deputy = sessions.open("robot3", "leader", "deputy")
    sessions.listen("robot3", robot3, BALLOT.key("deputy"), BALLOT.key("leader"))
    sessions.listen("leader", leader, BALLOT.key("deputy"), ROUTE.key("deputy"))
    sessions.listen("deputy", deputy, POSITION.key("robot3"), ROUTE.key("leader"))
    for key, process in (
        (BALLOT.key("deputy"), "robot3"),
        (BALLOT.key("deputy"), "leader"),
        (ROUTE.key("deputy"), "leader"),
    ):
        sessions.reaches(deputy, key, process)
    sessions.reaches(robot3, POSITION.key("robot3"), "deputy")
    sessions.reaches(leader, ROUTE.key("leader"), "deputy")


@pytest.mark.parametrize(
    ("sender", "own"),
    [
        ("robot1", POSITION.key("robot1")),
        ("reserve", BALLOT.key("reserve")),
        ("operator", ""),
        ("monitor", ""),
    ],
)
def test_certificate_does_not_permit_ballots_of_another_process(
    sessions: Sessions, sender: str, own: str
) -> None:
    ballots = [BALLOT.key(name) for name in ("leader", "deputy", "reserve")]
    robot2, deputy = sessions.open("robot2", "deputy")
    sessions.listen("robot2", robot2, *ballots, POSITION.key("leader"), POSITION.key("robot1"))
    with sessions.attacking(sender, "robot2") as session:
        for _ in range(20):
            for key in (BALLOT.key("leader"), BALLOT.key("deputy"), "*/ballot", "**"):
                session.put(key, b"forged")
        if sender != "reserve":  # a candidate may publish the leader's position
            session.put(POSITION.key("leader"), b"forged")
        if own:
            sessions.reaches(session, own, "robot2")  # sent later and on the same link
    sessions.reaches(deputy, BALLOT.key("deputy"), "robot2")
    assert set(sessions.received["robot2"]) == {BALLOT.key("deputy"), *([own] if own else [])}
    assert b"forged" not in sessions.payloads["robot2"]


def test_operator_orders_standby_and_receives_its_status(sessions: Sessions) -> None:
    deputy, operator = sessions.open("deputy", "operator")
    sessions.listen("operator", operator, STATUS.key("deputy"))
    sessions.answer(deputy, ORDER.key("deputy"))
    sessions.reaches(deputy, STATUS.key("deputy"), "operator")

    def obeyed() -> list[bool]:
        replies = operator.get(ORDER.key("deputy"), payload=b"hold", timeout=PATIENCE)
        return [reply.ok is not None for reply in replies]

    until(lambda: obeyed() == [True], what="the operator receives the reply of the standby")
    with sessions.attacking("robot1", "deputy") as session:
        assert list(session.get(ORDER.key("deputy"), payload=b"hold", timeout=0.5)) == []
