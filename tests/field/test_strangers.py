"""Links without a valid certificate: each is refused and counted, and changes no command."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from formation.deploy.fleet import access, certificates
from tests.field.assault import LASTS, attack, link, wait_for_refusals, without_effect
from tests.field.team import VICTIM, Team, driving, issued, mission
from tests.support.namespaces import until

pytestmark = [pytest.mark.namespaces, pytest.mark.processes]
FIREWALL = Path(access.__file__).with_name("firewall.nft")


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("team")) as team:
        yield team


def strange(folder: Path, name: str) -> Path:
    """Folder with a certificate of `name` by a foreign authority with the name of ours."""
    certificates.create(mission(), folder, days=1.0, authority_days=1.0, now=datetime.now(UTC))
    return folder / name


def test_certificate_of_a_foreign_authority_is_refused(team: Team, tmp_path: Path) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=strange(tmp_path / "rogue", "robot1"))
    with without_effect(team):
        assert attack(team, "dial", link=how, times=10) == 0
        wait_for_refusals(team, "certificate: bad signature", before, by=10)


@pytest.mark.parametrize(
    ("begins", "kind"),
    [(-timedelta(days=1), "certificate: expired"), (timedelta(days=1), "certificate: not valid yet")],
)
def test_certificate_outside_its_validity_is_refused(
    team: Team, tmp_path: Path, begins: timedelta, kind: str
) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=issued(team.desk, tmp_path / "id", "robot1", begins=begins))
    with without_effect(team):
        assert attack(team, "dial", link=how, times=5) == 0
        wait_for_refusals(team, kind, before, by=5)


def test_peer_without_tls_is_refused(team: Team) -> None:
    before = team.refused()
    address, port = team.computers[VICTIM].address, 7460
    plain = link(team, "robot1")
    plain["victims"] = [team.desk.endpoint(VICTIM).replace("tls/", "tcp/")]
    with without_effect(team):
        assert attack(team, "dial", link=plain, times=5) == 0
        attack(team, "talk", address=address, port=port, words=b"GET / HTTP/1.0\r\n\r\n".hex())
        wait_for_refusals(team, "not TLS", before, by=6)


def test_robot_router_is_reachable_only_on_loopback(team: Team) -> None:
    """The robot's ROS 2 router has neither certificates nor access rules."""
    reach = f"import socket; socket.create_connection(('{team.computers[VICTIM].address}', 7447), 2.0)"
    done = team.attacker.run(sys.executable, "-c", reach)
    assert "ConnectionRefusedError" in done.stderr


def test_operator_order_is_acknowledged_during_connection_flood(team: Team) -> None:
    """Zenoh pauses 0.1 s after each link that it refused; the firewall limits how often that happens."""
    team.computers[VICTIM].nft(FIREWALL.read_text(encoding="utf-8"))
    address = team.computers[VICTIM].address
    order = team.formation("order", "release", "-c", str(team.desk.file("operator")), "--json")
    with without_effect(team):
        crowd = team.attack("knock", address=address, port=7460)
        crowd.event("knocking")
        time.sleep(LASTS)
        answer = team.desk_computer.run(*order)
        assert not crowd.ended
        assert crowd.stop() == 0, crowd.errors
        assert crowd.event("done")["result"] > 0
    team.computers[VICTIM].nft("delete table inet formation")
    report = json.loads(answer.stdout.splitlines()[-1])
    assert VICTIM in {one["robot"] for one in report["acknowledged"]}, answer.stdout


def test_unfinished_handshakes_disturb_no_robot(team: Team) -> None:
    """When they close, Zenoh pauses 0.1 s for each; after that it accepts links again."""
    address = team.computers[VICTIM].address
    with without_effect(team):
        assert attack(team, "crowd", address=address, port=7460, number=200, seconds=LASTS) == 200
    until(lambda: attack(team, "dial", link=link(team, "robot3"), times=1) == 1, 60.0, "new links")


def test_certificate_expiring_during_link_holds_robot(tmp_path: Path) -> None:
    with driving(tmp_path, expires={"leader": 25.0}) as team:
        kind = "certificate: expired during the link"
        until(lambda: kind in team.refused(), 60.0, f"{kind!r} in the status")
        until(lambda: team.status()["state"] == "hold", what="the victim holds")
        again = f"dialling {team.desk.endpoint('leader')}: certificate: expired"
        until(lambda: again in team.refused(), what=f"{again!r} in the status")
        held = time.monotonic()
        until(lambda: len(team.commands(since=held)) > 20, what="commands while it holds")
        after = team.commands(since=held)
        assert {(command.speed, command.turn_rate) for command in after} == {(0.0, 0.0)}
        assert team.status()["state"] == "hold"
