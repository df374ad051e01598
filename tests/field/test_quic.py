"""A team linked by QUIC: links without proof are refused and counted, and change no command."""

from __future__ import annotations

import json
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from formation.deploy.fleet import access, certificates
from tests.field.assault import attack, held_by_an_expired_certificate, link, rises, without_effect
from tests.field.team import VICTIM, Team, driving, issued, mission

pytestmark = [pytest.mark.namespaces, pytest.mark.processes]
FIREWALL = Path(access.__file__).with_name("firewall.nft")


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    with driving(tmp_path_factory.mktemp("team"), protocol="quic") as team:
        yield team


@pytest.fixture
def strange(tmp_path: Path) -> Path:
    """The folder of robot1's certificate by an authority that has only our authority's name."""
    certificates.create(mission(), tmp_path / "rogue", days=1.0, authority_days=1.0, now=datetime.now(UTC))
    return tmp_path / "rogue" / "robot1"


def test_links_of_a_foreign_authority_are_refused_and_counted(team: Team, strange: Path) -> None:
    before = team.refused()
    with without_effect(team):
        assert attack(team, "dial", link=link(team, "robot1", identity=strange), times=10) == 0
        rises(team, "certificate: bad signature", before, by=10)


@pytest.mark.parametrize(
    ("begins", "kind"),
    [(-timedelta(days=1), "certificate: expired"), (timedelta(days=1), "certificate: not valid yet")],
)
def test_expired_and_future_certificates_are_refused_and_counted(
    team: Team, tmp_path: Path, begins: timedelta, kind: str
) -> None:
    before = team.refused()
    how = link(team, "robot1", identity=issued(team.desk, tmp_path / "id", "robot1", begins=begins))
    with without_effect(team):
        assert attack(team, "dial", link=how, times=5) == 0
        rises(team, kind, before, by=5)


@pytest.mark.parametrize("protocol", ["tls", "udp"])
def test_other_protocols_are_not_answered(team: Team, protocol: str) -> None:
    how = link(team, "robot1")
    place = how["victims"][0].partition("/")[2].partition("?")[0]
    how["victims"] = [f"{protocol}/{place}"]
    with without_effect(team):
        assert attack(team, "dial", link=how, times=2) == 0


def test_operator_is_heard_while_strangers_dial(team: Team, strange: Path) -> None:
    team.computers[VICTIM].nft(FIREWALL.read_text(encoding="utf-8"))
    order = team.formation("order", "release", "-c", str(team.desk.file("operator")), "--json")
    with without_effect(team):
        strangers = team.attack("dial", link=link(team, "robot1", identity=strange), times=1000)
        answer = team.desk_computer.run(*order)
        assert not strangers.ended
        strangers.stop()
    team.computers[VICTIM].nft("delete table inet formation")
    report = json.loads(answer.stdout.splitlines()[-1])
    assert VICTIM in {one["robot"] for one in report["acknowledged"]}, answer.stdout


def test_certificate_expiring_during_link_holds_robot(tmp_path: Path) -> None:
    with driving(tmp_path, expires={"leader": 25.0}, protocol="quic") as team:
        held_by_an_expired_certificate(team)
