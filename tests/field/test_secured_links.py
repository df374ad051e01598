"""Real sessions under mTLS and access control: permitted messages pass, all others are refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from formation.monitor.metrics.keys import watched
from formation.topics import ORDER, POSITION
from formation.transport.bus_config import BusConfig
from formation.transport.session import settings_of
from tests.field.missions import in_the_field
from tests.field.sessions import Sessions, prepared
from tests.support.child import free_endpoint
from tests.support.namespaces import PATIENCE, until

pytestmark = pytest.mark.processes


@pytest.fixture(params=[None, "reds"], ids=["without team", "with team"])
def sessions(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Sessions]:
    port = free_endpoint().rpartition(":")[2]
    mission = in_the_field("six_robots", lambda i: f"tls/127.0.0.{i + 1}:{port}", team=request.param)
    with ExitStack() as stack:
        yield Sessions(prepared(mission, tmp_path / "secrets"), stack)


@pytest.mark.parametrize("order", [("robot2", "robot3"), ("robot3", "robot2")])
def test_neighbour_is_received_in_any_start_order(sessions: Sessions, order: tuple[str, str]) -> None:
    """robot3, which is listed later, dials robot2; it measures robot2."""
    one, other = sessions.open(*order)
    robot2, robot3 = (one, other) if order[0] == "robot2" else (other, one)
    sessions.listen("robot3", robot3, "robot2/position")
    sessions.reaches(robot2, "robot2/position", "robot3")


def test_late_listener_receives_neighbour(sessions: Sessions) -> None:
    robot2, robot3, robot4 = sessions.open("robot2", "robot3", "robot4")
    sessions.listen("robot3", robot3, "robot2/position")
    sessions.reaches(robot2, "robot2/position", "robot3")
    publisher = robot3.declare_publisher("robot3/position")
    assert not publisher.matching_status.matching  # type: ignore[attr-defined]
    sessions.listen("robot4", robot4, "robot3/position")
    until(lambda: publisher.matching_status.matching, what="robot3 has a subscriber")  # type: ignore[attr-defined]
    publisher.put(b"something")
    until(lambda: sessions.received["robot4"]["robot3/position"] == 1, what="robot4 receives robot3")


def test_monitor_receives_every_key_of_a_robot(sessions: Sessions) -> None:
    robot3, monitor = sessions.open("robot3", "monitor")
    keys = [one.key for one in watched(sessions.desk.mission)]
    sessions.listen("monitor", monitor, *keys)
    reported = [
        one.key
        for one in watched(sessions.desk.mission)
        if one.robot == "robot3" and one.topic.name != "ground_truth"
    ]
    assert len(reported) >= 5
    for key in reported:
        sessions.reaches(robot3, key, "monitor")
    assert set(sessions.received["monitor"]) == set(reported)


def test_only_operator_orders_are_acknowledged(sessions: Sessions) -> None:
    requested: list[bytes] = []
    robots = dict(zip(("robot2", "robot3"), sessions.open("robot2", "robot3"), strict=True))
    for name, session in robots.items():
        key = ORDER.key(name)

        def answer(query: zenoh.Query, key: str = key) -> None:
            with query:
                requested.append(query.payload.to_bytes() if query.payload else b"")
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

    until(all_have, what="both robots acknowledge the request to all")
    assert acknowledged(operator, "robot3/order", b"one", PATIENCE) == {"robot3/order"}
    (robot4, monitor) = sessions.open("robot4", "monitor")
    sessions.listen("robot4", robot4, "robot3/position")
    sessions.listen("monitor", monitor, "robot3/status")
    sessions.reaches(robots["robot3"], "robot3/position", "robot4")  # now they are linked
    sessions.reaches(robots["robot3"], "robot3/status", "monitor")
    for other in (robot4, monitor):
        assert acknowledged(other, "robot3/order", b"forged") == set()
    with sessions.attacking("robot4", "robot3") as robot4s_key:
        assert acknowledged(robot4s_key, "robot3/order", b"forged") == set()
    assert b"forged" not in requested


def test_certificate_of_robot_cannot_publish_for_another_robot(sessions: Sessions) -> None:
    (robot3,) = sessions.open("robot3")
    sessions.listen("robot3", robot3, *map(POSITION.key, ("robot1", "robot2")))
    with sessions.attacking("robot2", "robot3") as robot2s_key:
        for _ in range(20):
            robot2s_key.put("robot1/position", b"forged")
            robot2s_key.put("*/position", b"forged")
        sessions.reaches(robot2s_key, "robot2/position", "robot3")  # sent later and on the same link
    assert set(sessions.received["robot3"]) == {"robot2/position"}


def test_robot_sends_nothing_to_impostor_at_neighbours_address(sessions: Sessions) -> None:
    """robot3 dials robot2's address, where a session with robot4's valid certificate answers."""
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
    assert not sessions.received["impostor"]
