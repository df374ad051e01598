"""Real sessions under mTLS and access control: permitted messages pass, all others are refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from formation.monitor.metrics.keys import watched
from formation.transport.bus_config import BusConfig
from formation.transport.session import settings_of
from tests.field.missions import in_the_field
from tests.field.sessions import Sessions, prepared
from tests.support.child import free_endpoint
from tests.support.namespaces import until

pytestmark = pytest.mark.processes


@pytest.fixture
def sessions(tmp_path: Path) -> Iterator[Sessions]:
    port = free_endpoint().rpartition(":")[2]
    mission = in_the_field("six_robots", lambda i: f"tls/127.0.0.{i + 1}:{port}", team="reds")
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
