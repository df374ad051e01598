"""Real sessions under mTLS and access control: what must pass does, whoever dials and whenever it comes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from formation.topics import ORDER, POSITION
from formation.transport.bus_config import BusConfig
from formation.transport.session import settings_of
from monitor.figures.keys import watched
from tests.field.missions import in_the_field
from tests.field.namespaces import PATIENCE, until
from tests.field.sessions import Sessions, prepared
from tests.processes.child import free_endpoint

pytestmark = pytest.mark.processes


@pytest.fixture(params=[None, "reds"], ids=["without team", "with team"])
def sessions(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Sessions]:
    port = free_endpoint().rpartition(":")[2]
    mission = in_the_field("six_robots", lambda i: f"tls/127.0.0.{i + 1}:{port}", team=request.param)
    with ExitStack() as stack:
        yield Sessions(prepared(mission, tmp_path / "secrets"), stack)


@pytest.mark.parametrize("order", [("robot2", "robot3"), ("robot3", "robot2")])
def test_a_neighbour_is_heard_whoever_came_first(sessions: Sessions, order: tuple[str, str]) -> None:
    """Of the two robot3, listed later, dials; it measures robot2."""
    one, other = sessions.open(*order)
    robot2, robot3 = (one, other) if order[0] == "robot2" else (other, one)
    sessions.listen("robot3", robot3, "robot2/position")
    sessions.reaches(robot2, "robot2/position", "robot3")


def test_a_neighbour_is_heard_by_who_listens_late(sessions: Sessions) -> None:
    robot2, robot3, robot4 = sessions.open("robot2", "robot3", "robot4")
    sessions.listen("robot3", robot3, "robot2/position")
    sessions.reaches(robot2, "robot2/position", "robot3")
    publisher = robot3.declare_publisher("robot3/position")
    assert not publisher.matching_status.matching  # type: ignore[attr-defined]
    sessions.listen("robot4", robot4, "robot3/position")
    until(lambda: publisher.matching_status.matching, what="robot3 knows who listens")  # type: ignore[attr-defined]
    publisher.put(b"something")
    until(lambda: sessions.heard["robot4"]["robot3/position"] == 1, what="robot4 hears robot3")


def test_the_monitor_hears_all_that_a_robot_tells_the_fleet(sessions: Sessions) -> None:
    robot3, monitor = sessions.open("robot3", "monitor")
    keys = [one.key for one in watched(sessions.desk.mission)]
    sessions.listen("monitor", monitor, *keys)
    told = [
        one.key
        for one in watched(sessions.desk.mission)
        if one.robot == "robot3" and one.topic.name != "ground_truth"
    ]
    assert len(told) >= 5
    for key in told:
        sessions.reaches(robot3, key, "monitor")
    assert set(sessions.heard["monitor"]) == set(told)


def test_the_operators_order_is_acknowledged_and_nobody_elses_is(sessions: Sessions) -> None:
    asked: list[bytes] = []
    robots = dict(zip(("robot2", "robot3"), sessions.open("robot2", "robot3"), strict=True))
    for name, session in robots.items():
        key = ORDER.key(name)

        def answer(query: zenoh.Query, key: str = key) -> None:
            with query:
                asked.append(query.payload.to_bytes() if query.payload else b"")
                query.reply(key, b"obeyed")

        session.declare_queryable(key, zenoh.handlers.Callback(answer, indirect=False))
    (operator,) = sessions.open("operator")
    answers: set[str] = set()

    def acknowledged(asks: zenoh.Session, key: str, payload: bytes, patience: float = 0.5) -> set[str]:
        replies = asks.get(key, payload=payload, timeout=patience, target=zenoh.QueryTarget.ALL)
        return {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}

    def all_have() -> bool:
        answers.update(acknowledged(operator, "*/order", b"all"))
        return answers == {"robot2/order", "robot3/order"}

    until(all_have, what="both acknowledge what all are asked")
    assert acknowledged(operator, "robot3/order", b"one", PATIENCE) == {"robot3/order"}
    (robot4, monitor) = sessions.open("robot4", "monitor")
    sessions.listen("robot4", robot4, "robot3/position")
    sessions.listen("monitor", monitor, "robot3/status")
    sessions.reaches(robots["robot3"], "robot3/position", "robot4")  # now they are linked
    sessions.reaches(robots["robot3"], "robot3/status", "monitor")
    for stranger in (robot4, monitor):
        assert acknowledged(stranger, "robot3/order", b"forged") == set()
    with sessions.attacking("robot4", "robot3") as robot4s_key:
        assert acknowledged(robot4s_key, "robot3/order", b"forged") == set()
    assert b"forged" not in asked


def test_a_key_of_another_robot_is_not_taken_from_who_keeps_to_no_rules(sessions: Sessions) -> None:
    (robot3,) = sessions.open("robot3")
    sessions.listen("robot3", robot3, *map(POSITION.key, ("robot1", "robot2")))
    with sessions.attacking("robot2", "robot3") as robot2s_key:
        for _ in range(20):
            robot2s_key.put("robot1/position", b"forged")
            robot2s_key.put("*/position", b"forged")
        sessions.reaches(robot2s_key, "robot2/position", "robot3")  # sent later and on the same link
    assert set(sessions.heard["robot3"]) == {"robot2/position"}


def test_a_robot_does_not_talk_to_who_only_has_its_neighbours_address(sessions: Sessions) -> None:
    """robot3 dials robot2's place and finds somebody with a good certificate, but not of that place."""
    desk = sessions.desk
    (robot3,) = sessions.open("robot3")
    settings = settings_of(BusConfig(config_file=desk.file("robot4"), namespace=desk.mission.team or ""))
    settings.insert_json5("listen/endpoints", f'["{desk.endpoint("robot2")}"]')
    settings.insert_json5("connect/endpoints", "[]")
    settings.insert_json5("access_control", '{enabled: false, default_permission: "allow"}')
    with zenoh.open(settings) as impostor:
        honest = robot3.declare_publisher("robot3/position")
        sessions.listen("impostor", impostor, "robot3/position")
        with pytest.raises(AssertionError, match="robot3 is linked"):
            until(lambda: list(robot3.info.peers_zid()), 2.5, "robot3 is linked")
        honest.put(b"something")
    assert not sessions.heard["impostor"]
