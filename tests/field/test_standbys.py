"""Standbys in the field: certificates, bundles, links and push."""

from __future__ import annotations

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509

from formation.deploy.fleet import authority, bundle, certificates, fleet
from formation.deploy.fleet.access import hosts
from formation.deploy.fleet.on_robot import VERSION
from formation.deploy.fleet.wheels import Target
from formation.deploy.refusal import Refusal
from formation.mission.file import DESK, parse
from tests.field.deployed import TEXT

PI = Target("aarch64", "3.12")
NOW = datetime.now(UTC)
WITH = TEXT + '\n[standbys.deputy]\nendpoint = "tls/10.77.0.4:7460"\n'


@pytest.fixture
def secrets(tmp_path: Path) -> Path:
    folder = tmp_path / "secrets"
    certificates.create(parse(WITH), folder, days=1.0, authority_days=1.0, now=NOW)
    return folder


@pytest.fixture
def bundles(secrets: Path, tmp_path: Path, no_wheels: None) -> Path:  # noqa: ARG001
    """Bundles of a team with a standby."""
    bundle.make(parse(WITH), WITH, tmp_path / "out", secrets, PI, now=NOW)
    return tmp_path / "out"


def name_in(pem: Path) -> str:
    return x509.load_pem_x509_certificate(pem.read_bytes()).subject.rfc4514_string()


def settings(file: Path) -> dict[str, Any]:
    """Settings of a configuration file, without its comment."""
    lines = [line for line in file.read_text().splitlines() if not line.startswith("//")]
    found: dict[str, Any] = json.loads("\n".join(lines))
    return found


def requested(*words: str | Path) -> fleet.Fleet:
    """The fleet that a push with these arguments is for."""
    options = argparse.ArgumentParser()
    fleet.add_flags(options)
    return fleet.read(options.parse_args([str(word) for word in words]))


def test_standby_certificate_has_its_name_and_address(secrets: Path) -> None:
    assert name_in(secrets / "deputy" / "certificate.pem") == "CN=deputy"
    pair = certificates.read(secrets, "deputy", NOW)
    assert authority.addresses(pair.certificate) == ("10.77.0.4",)
    assert certificates.left_over(secrets, parse(WITH)) == {}
    assert set(certificates.left_over(secrets, parse(TEXT))) == {"deputy"}


def test_standby_bundle_has_own_unit_and_key(bundles: Path) -> None:
    units = {path.name for path in (bundles / "deputy" / "units").iterdir()}
    assert units == {"formation-standby.service"}
    assert {path.name for path in (bundles / "deputy" / "samples").iterdir()} == {"firewall.nft"}
    result = json.loads((bundles / "deputy" / VERSION).read_text())
    assert (result["robot"], result["role"], result["bringup"]) == ("deputy", "standby", "")
    assert name_in(bundles / "deputy" / "certificates" / "certificate.pem") == "CN=deputy"
    own = (bundles / "deputy" / "certificates" / "key.pem").read_text()
    for name in ("leader", "robot1", "robot2"):
        held = [path.read_text() for path in (bundles / name).rglob("*") if path.is_file()]
        assert not any(own in text for text in held)


def test_standby_dials_all_and_is_dialled_by_visitors(bundles: Path) -> None:
    ends = [f"tls/10.77.0.{number}:7460" for number in (1, 2, 3, 4)]
    for name, dialled in {
        "leader": [], "robot1": ends[:1], "robot2": ends[:2], "deputy": ends[:3],
    }.items():  # fmt: skip
        assert settings(bundles / name / "zenoh.json5")["connect"]["endpoints"] == dialled
    for visitor in ("monitor", "operator"):
        assert settings(bundles / DESK / f"{visitor}.json5")["connect"]["endpoints"] == ends


def test_desk_bundle_has_certificate_and_configuration_of_standby(bundles: Path) -> None:
    desk = bundles / DESK
    assert name_in(desk / "deputy" / "certificate.pem") == "CN=deputy"
    file = settings(desk / "deputy.json5")
    assert file["listen"]["endpoints"] == ["tls/10.77.0.4:7460"]
    assert file["transport"]["link"]["tls"]["listen_private_key"] == str(desk / "deputy" / "key.pem")


def test_push_addresses_standby_by_mission_endpoint(bundles: Path) -> None:
    assert set(fleet.bundles_in(bundles)) == {"deputy", "leader", "robot1", "robot2"}
    assert requested(bundles).robots["deputy"].address == "10.77.0.4"


def test_local_standby_is_pushed_only_when_named(bundles: Path, capsys: pytest.CaptureFixture[str]) -> None:
    here = (bundles / "deputy" / "mission.toml").read_text().replace("tls/10.77.0.4", "tls/127.0.0.1")
    (bundles / "deputy" / "mission.toml").write_text(here)
    assert set(requested(bundles).robots) == {"leader", "robot1", "robot2"}
    assert "deputy: leads from this machine, left out" in capsys.readouterr().err
    assert set(requested(bundles, "--only", "deputy").robots) == {"deputy"}


def test_standby_without_tls_endpoint_is_refused() -> None:
    with pytest.raises(
        Refusal, match=r"deputy without endpoint; .* and each standby.*in \[standbys.deputy\]"
    ):
        hosts(parse(TEXT + "\n[standbys.deputy]\n"))
    with pytest.raises(Refusal, match="of deputy: must begin with 'tls/'"):
        hosts(parse(WITH.replace("tls/10.77.0.4", "tcp/10.77.0.4")))


@pytest.mark.parametrize(("name", "conflict"), [("desk", "the desk's folder"), ("chief", "")])
def test_standby_with_name_of_desk_folder_is_refused(name: str, conflict: str) -> None:
    mission = parse(WITH.replace("standbys.deputy", f"standbys.{name}"))
    if not conflict:
        bundle.refuse_unfit(mission)
        return
    with pytest.raises(Refusal, match=f"no robot or standby can be called {name!r}, as that is {conflict}"):
        bundle.refuse_unfit(mission)


def test_standby_named_like_leader_folder_is_refused() -> None:
    text = WITH.replace('"leader"', '"chief"').replace("robots.leader", "robots.chief")
    bundle.refuse_unfit(parse(text))
    with pytest.raises(Refusal, match="no standby can be called 'leader', as on the desk that is chief's"):
        bundle.refuse_unfit(parse(text.replace("standbys.deputy", "standbys.leader")))
