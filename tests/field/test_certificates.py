"""Certificates: contents, file modes, renewal and refusals."""

from __future__ import annotations

import json
import os
import stat
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID

from formation.deploy import cli
from formation.deploy.fleet import authority, certificates
from formation.deploy.fleet.access import hosts
from formation.deploy.refusal import Refusal
from formation.mission.file import load, parse
from formation.mission.model import Mission
from formation.transport.security.signing import issued_by
from tests.field.deployed import TEXT
from tests.field.missions import in_the_field, listening, on_a_wireless_network
from tests.support.needs import path_of

PAIR = in_the_field("turtlebot3_pair", on_a_wireless_network)
NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)
HOLDERS = ["ca", "leader", "robot1", "robot2", "monitor", "operator"]


def made(folder: Path, mission: Mission = PAIR, days: float = 30.0, now: datetime = NOW) -> Path:
    certificates.create(mission, folder, days=days, authority_days=365.0, now=now)
    return folder


def renewed(folder: Path, mission: Mission = PAIR, days: float = 30.0, now: datetime = NOW) -> None:
    certificates.renew(mission, folder, days=days, now=now)


@pytest.fixture
def secrets(tmp_path: Path) -> Path:
    return made(tmp_path / "secrets")


def test_every_process_certificate_has_its_name_and_address(secrets: Path) -> None:
    root = certificates.read_authority(secrets)
    for name in HOLDERS[1:]:
        pair = certificates.read(secrets, name, NOW)
        assert pair.name == name
        assert isinstance(pair.key.curve, ec.SECP256R1)
        assert issued_by(pair.certificate, root.certificate)
        constraints = pair.certificate.extensions.get_extension_for_class(x509.BasicConstraints)
        assert not constraints.value.ca
        place = [hosts(PAIR)[name].address] if name in PAIR.robots else []
        assert list(authority.addresses(pair.certificate)) == place
        uses = pair.certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert ExtendedKeyUsageOID.CLIENT_AUTH in uses
        assert (ExtendedKeyUsageOID.SERVER_AUTH in uses) == (name in PAIR.robots)


def test_certificate_accepts_host_name_instead_of_address(tmp_path: Path) -> None:
    mission = listening(PAIR, {"robot1": "tls/robot1.local:7460", "robot2": "tls/10.77.0.12:7460"})
    folder = made(tmp_path / "secrets", mission)
    for robot, place in (("robot1", "robot1.local"), ("robot2", "10.77.0.12")):
        assert list(authority.addresses(certificates.read(folder, robot, NOW).certificate)) == [place]


def test_certificate_begins_in_past_and_never_outlives_authority(tmp_path: Path) -> None:
    folder = tmp_path / "secrets"
    made_now = certificates.create(PAIR, folder, days=30.0, authority_days=7.0, now=NOW)
    assert made_now["ca"].expires == NOW + timedelta(days=7)
    for pair in made_now.values():
        assert pair.certificate.not_valid_before_utc == NOW - timedelta(hours=1)
        assert pair.expires == NOW + timedelta(days=7)
    made(tmp_path / "other", days=3.0)
    assert certificates.read(tmp_path / "other", "robot1", NOW).expires == NOW + timedelta(days=3)


def test_certificate_that_is_not_valid_yet_is_refused(secrets: Path) -> None:
    """It was made by a clock that was ahead, or this one is behind."""
    with pytest.raises(Refusal, match="is valid only from 2026-06-01 11:00 UTC on"):
        certificates.read(secrets, "robot1", NOW - timedelta(hours=2))


@pytest.mark.parametrize("table", ["robots", "standbys"])
def test_name_of_the_authority_is_refused(tmp_path: Path, table: str) -> None:
    """Its key would replace that of the authority."""
    text = TEXT.replace("robot2", "ca")
    if table == "standbys":
        text = TEXT + '[standbys.ca]\nendpoint = "tls/10.77.0.9:7460"\n'
    with pytest.raises(Refusal, match="can be called 'ca': its key"):
        made(tmp_path / "secrets", parse(text, "three.toml"))
    assert not (tmp_path / "secrets").exists()


def test_files_are_private_and_ignored_by_git(tmp_path: Path) -> None:
    git = path_of("git")
    subprocess.run([git, "init", "--quiet", str(tmp_path)], check=True)
    mask = os.umask(0)
    try:
        folder = made(tmp_path / "secrets")
    finally:
        os.umask(mask)
    for path in (folder, *folder.rglob("*")):
        allowed = 0o700 if path.is_dir() else 0o600
        assert stat.S_IMODE(path.stat().st_mode) == allowed, path
    status = [git, "-C", str(tmp_path), "status", "--porcelain", "--untracked-files=all"]
    assert subprocess.run(status, check=True, capture_output=True).stdout == b""


def test_folder_readable_by_others_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "open"
    folder.mkdir(mode=0o755)
    folder.chmod(0o755)
    with pytest.raises(Refusal, match=r"mode 755.*chmod 700"):
        made(folder)
    assert list(folder.iterdir()) == []


def test_renewal_refuses_robot_folder_readable_by_others(secrets: Path) -> None:
    before = (secrets / "robot1" / "key.pem").read_bytes()
    (secrets / "robot1").chmod(0o750)
    with pytest.raises(Refusal, match=r"robot1: other users of this machine can read it"):
        renewed(secrets)
    assert (secrets / "robot1" / "key.pem").read_bytes() == before


def test_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "home"
    folder.mkdir(mode=0o700)
    (folder / "diary").touch()
    with pytest.raises(Refusal, match="not empty and no folder of certificates"):
        made(folder)
    assert [path.name for path in folder.iterdir()] == ["diary"]


def test_existing_keys_are_kept_without_renew(secrets: Path) -> None:
    before = {path: path.read_bytes() for path in secrets.rglob("*.pem")}
    with pytest.raises(Refusal, match="holds keys already; --renew"):
        made(secrets)
    assert {path: path.read_bytes() for path in secrets.rglob("*.pem")} == before


def test_renewal_makes_new_keys_under_same_authority(secrets: Path) -> None:
    root = certificates.read_authority(secrets)
    before = certificates.read(secrets, "robot1", NOW)
    later = NOW + timedelta(days=20)
    renewed(secrets, now=later)
    after = certificates.read(secrets, "robot1", later)
    assert certificates.read_authority(secrets).certificate == root.certificate
    assert after.expires == later + timedelta(days=30)
    assert after.key_pem != before.key_pem
    assert issued_by(after.certificate, root.certificate)
    assert not list(secrets.rglob(".*.pem.*"))


def test_renewal_refuses_missing_or_expired_authority(secrets: Path, tmp_path: Path) -> None:
    with pytest.raises(Refusal, match="no authority to renew under; leave out --renew"):
        renewed(tmp_path / "nowhere")
    assert not (tmp_path / "nowhere").exists()
    with pytest.raises(Refusal, match="the authority has expired on 2027-06-01"):
        renewed(secrets, now=NOW + timedelta(days=366))


def test_certificate_of_former_robot_is_named_while_valid(secrets: Path) -> None:
    six = in_the_field("six_robots", on_a_wireless_network)
    assert set(certificates.left_over(secrets, six)) == {"leader"}
    text = certificates.words(secrets, {}, certificates.left_over(secrets, six), NOW)
    assert "leader: not in this mission; its certificate is valid until 2026-07-01" in text


def test_read_refuses_unusable_certificates_with_reason(secrets: Path) -> None:
    with pytest.raises(Refusal, match="no certificate for robot9"):
        certificates.read(secrets, "robot9", NOW)
    with pytest.raises(Refusal, match="expired on 2026-07-01 12:00 UTC; renew"):
        certificates.read(secrets, "robot1", NOW + timedelta(days=31))
    mine, others = secrets / "robot1", secrets / "robot2"
    (mine / "key.pem").write_bytes((others / "key.pem").read_bytes())
    with pytest.raises(Refusal, match=r"is not the key of"):
        certificates.read(secrets, "robot1", NOW)
    (mine / "certificate.pem").write_bytes((others / "certificate.pem").read_bytes())
    with pytest.raises(Refusal, match="is the certificate of 'robot2', not of 'robot1'"):
        certificates.read(secrets, "robot1", NOW)
    (others / "ca.pem").write_bytes((others / "certificate.pem").read_bytes())
    with pytest.raises(Refusal, match="was not issued by"):
        certificates.read(secrets, "robot2", NOW)
    (others / "certificate.pem").write_text("nonsense")
    with pytest.raises(Refusal, match="is not a certificate"):
        certificates.read(secrets, "robot2", NOW)
    (others / "certificate.pem").unlink()
    with pytest.raises(Refusal, match="No such file"):
        certificates.read(secrets, "robot2", NOW)


@pytest.mark.parametrize(
    ("endpoints", "reason"),
    [
        ({"leader": None, "robot2": None}, "leader, robot2 without endpoint; in the field every robot"),
        ({"robot1": "tcp/192.168.1.11:7460"}, "of robot1: must begin with 'tls/'"),
        ({"robot1": "tls/0.0.0.0:7460"}, "must be the address that the others dial"),
        ({"robot1": "tls/[fe80::1%wlan0]:7460"}, "must be an IPv4 address or a name: Zenoh"),
        ({"robot1": "tls/[fd00::12]:7460"}, "must be an IPv4 address or a name: Zenoh"),
        ({"robot1": "tls/röbot1.local:7460"}, "must be an IPv4 address or a name in ASCII"),
    ],
)
def test_mission_unfit_for_field_is_refused(
    endpoints: dict[str, str | None], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(Refusal, match=reason):
        made(tmp_path / "secrets", listening(PAIR, endpoints))
    assert not (tmp_path / "secrets").exists()


def test_robot_named_monitor_is_refused(tmp_path: Path) -> None:
    data = PAIR.model_dump()
    data["robots"]["monitor"] = data["robots"].pop("robot2")
    data["shapes"]["triangle"]["monitor"] = data["shapes"]["triangle"].pop("robot2")
    with pytest.raises(Refusal, match="no robot of the field can be called 'monitor'"):
        made(tmp_path / "secrets", Mission.model_validate(data))


def mission_file(folder: Path) -> Path:
    """Write the shipped pair with endpoints, as a user does; return the file."""
    text = (Path(cli.__file__).parent / "missions" / "turtlebot3_pair.toml").read_text()
    for number, name in enumerate(PAIR.names):
        table = f"[robots.{name}]\n"
        assert table in text
        text = text.replace(table, f'{table}endpoint = "{on_a_wireless_network(number)}"\n')
    (folder / "field.toml").write_text(text)
    assert load(str(folder / "field.toml")).robots["robot2"].endpoint == "tls/192.168.1.12:7460"
    return folder / "field.toml"


def test_command_prints_expiry_as_text_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mission, folder = mission_file(tmp_path), tmp_path / "secrets"
    requested = ["deploy", "certificates", str(mission), "--out", str(folder), "--json", "--days", "7"]
    assert cli.main(requested) == 0
    out, err = capsys.readouterr()
    words, result = err.splitlines(), json.loads(out)
    assert list(result["certificates"]) == HOLDERS
    assert result["certificates"]["robot2"]["days"] == pytest.approx(7.0, abs=0.01)
    assert result["certificates"]["robot2"]["addresses"] == ["192.168.1.12"]
    assert any(line.startswith("robot2 ") and line.endswith("192.168.1.12") for line in words)
    assert "PRIVATE" not in err + out

    assert cli.main(requested) == 2
    assert "--renew" in capsys.readouterr().err
    assert cli.main([*requested, "--renew"]) == 0
    capsys.readouterr()
    assert cli.main(["deploy", "certificates", "turtlebot3_pair", "--out", str(tmp_path / "other")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "without endpoint" in error
