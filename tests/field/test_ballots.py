"""A standby under certificates: its ballots and routes reach the team, and the operator's orders reach it."""

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
