"""`formation deploy bundle`: files of a bundle, releases and refusals."""

from __future__ import annotations

import json
import shlex
import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509

from formation.deploy.cli import main
from formation.deploy.fleet import bundle, certificates, wheels
from formation.deploy.fleet.fleet import BUNDLE
from formation.deploy.fleet.on_robot import VERSION
from formation.deploy.fleet.wheels import Target
from formation.mission.file import DESK, configuration_of, load, parse
from tests.field.deployed import TEXT, mission, secrets

pytestmark = pytest.mark.usefixtures("no_wheels")
PI = Target("aarch64", "3.12")
NOW = datetime.now(UTC)
ROBOTS = ("leader", "robot1", "robot2")


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    return secrets(tmp_path / "secrets")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "three.toml"
    path.write_text(TEXT)
    return path


Make = Callable[..., dict[str, Any]]


@pytest.fixture
def make(keys: Path, tmp_path: Path) -> Make:
    """Function that bundles the mission `TEXT`, or another text, into tmp_path/out."""

    def made(text: str = TEXT, now: datetime = NOW, target: Target = PI, **rest: str) -> dict[str, Any]:
        return bundle.make(parse(text), text, tmp_path / "out", keys, target, now=now, **rest)  # type: ignore[arg-type]

    return made


def version(out: Path, robot: str) -> dict[str, Any]:
    output: dict[str, Any] = json.loads((out / robot / VERSION).read_text())
    return output


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize("name", ["old", "wheels"])
def test_robot_may_be_called_as_a_folder_is(name: str, tmp_path: Path) -> None:
    text = TEXT.replace("robot2", name)
    named = parse(text, "three.toml")
    certificates.create(named, tmp_path / "secrets", days=1.0, authority_days=1.0, now=NOW)
    for _ in range(2):
        bundle.make(named, text, tmp_path / "out", tmp_path / "secrets", PI, now=NOW)
        assert (tmp_path / "out" / name / VERSION).is_file()


def test_robot_bundle_holds_all_needed_files(make: Make, tmp_path: Path) -> None:
    make()
    out = tmp_path / "out"
    common = {
        "mission.toml", "zenoh.json5", "install.sh", "VERSION.json", "wheels/requirements.txt",
        "wheels/zenoh_formation-0.1.0-py3-none-any.whl", "samples/firewall.nft",
        *(f"certificates/{name}.pem" for name in ("ca", "certificate", "key")),
    }  # fmt: skip
    agent = {f"units/formation-{role}.service" for role in ("agent", "watchdog")}
    names = ("turtlebot3.service", "zenoh-bridge-ros2dds.service", "conf.json5")
    samples = {f"samples/{name}" for name in names}
    for robot in ("robot1", "robot2"):
        assert files(out / robot) == common | agent | samples
    assert files(out / "leader") == common | {"units/formation-leader.service"}
    assert (out / "robot1" / "mission.toml").read_text() == TEXT


def test_desk_bundle_has_monitor_operator_and_leader(make: Make, tmp_path: Path) -> None:
    make()
    desk, processes = tmp_path / "out" / DESK, ("monitor", "operator", "leader")
    pems = {f"{one}/{name}.pem" for one in processes for name in ("ca", "certificate", "key")}
    assert files(desk) == {"mission.toml", *(f"{one}.json5" for one in processes), *pems}
    for one in processes:
        assert str(desk / one / "key.pem") in (desk / f"{one}.json5").read_text()
    pem = (desk / "leader" / "certificate.pem").read_bytes()
    assert x509.load_pem_x509_certificate(pem).subject.rfc4514_string() == "CN=leader"


def test_firewall_sample_has_port_of_robot(make: Make, tmp_path: Path) -> None:
    make(TEXT.replace("10.77.0.2:7460", "10.77.0.2:7470"))
    ports = {name: (tmp_path / "out" / name / "samples" / "firewall.nft").read_text() for name in ROBOTS}
    assert "tcp dport 7470 " in ports["robot1"]
    assert "tcp dport 7460 " in ports["robot2"]
    assert "7460" not in ports["robot1"]


def test_each_robot_gets_only_its_own_key(make: Make, keys: Path, tmp_path: Path) -> None:
    make()
    every = {(keys / name / "key.pem").read_text(): name for name in (*ROBOTS, "monitor", "operator", "ca")}
    out = tmp_path / "out"
    for robot in ROBOTS:
        texts = [path.read_bytes() for path in (out / robot).rglob("*") if path.is_file()]
        held = {name for key, name in every.items() if any(key.encode() in text for text in texts)}
        assert held == {robot}
        pem = (out / robot / "certificates" / "certificate.pem").read_bytes()
        assert x509.load_pem_x509_certificate(pem).subject.rfc4514_string() == f"CN={robot}"
    assert (keys / "ca" / "key.pem").read_text() not in "".join(
        path.read_text() for path in (out / DESK).rglob("*.pem")
    )


def test_secret_files_are_private_and_ignored_by_git(make: Make, tmp_path: Path) -> None:
    make()
    out = tmp_path / "out"
    assert stat.S_IMODE(out.stat().st_mode) == 0o700
    for path in out.rglob("*"):
        mode = stat.S_IMODE(path.stat().st_mode)
        assert not mode & 0o022, path
        if path.suffix == ".pem":
            assert mode == 0o600, path
            assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert (out / ".gitignore").read_text() == "*\n", "git would add the keys"


def test_version_file_describes_bundle(make: Make, tmp_path: Path) -> None:
    made = make()
    output = version(tmp_path / "out", "robot2")
    assert output["release"] == made["releases"]["robot2"] == bundle.release_id(tmp_path / "out" / "robot2")
    assert (output["robot"], output["role"], output["mission"]) == ("robot2", "agent", "three-in-a-row")
    assert (output["platform"], output["python"], output["formation"]) == ("aarch64", "3.12", "0.1.0")
    assert output["made"] == NOW.isoformat(timespec="seconds")
    assert datetime.fromisoformat(output["certificate_until"]) > NOW
    assert version(tmp_path / "out", "leader")["role"] == "leader"


def test_release_depends_on_mission_and_not_on_time(make: Make, tmp_path: Path) -> None:
    first = make()["releases"]
    before = (tmp_path / "out" / "robot1" / VERSION).read_text()
    assert make(now=NOW + timedelta(minutes=1))["releases"] == first
    assert (tmp_path / "out" / "robot1" / VERSION).read_text() == before, "push would send it again"
    changed = make(TEXT.replace("speed = 0.05", "speed = 0.06"))["releases"]
    assert not set(changed.values()) & set(first.values())


def test_renewed_certificates_make_a_new_release(make: Make, keys: Path) -> None:
    first = make()["releases"]
    certificates.renew(mission(), keys, days=1.0, now=NOW)
    assert not set(make()["releases"].values()) & set(first.values())


def test_bundle_of_removed_robot_is_deleted(make: Make, tmp_path: Path) -> None:
    make()
    start, _, _ = TEXT.partition("[robots.robot2]")
    fewer = start.replace("robot2 = [-0.8, 0.0]\n", "") + "[[route]]\nspeed = 0.05\nheading_deg = 0\n"
    make(fewer)
    out = tmp_path / "out"
    assert {path.name for path in out.iterdir()} == {"leader", "robot1", DESK, BUNDLE, ".gitignore"}
    assert json.loads((out / BUNDLE).read_text()) == {"folders": ["leader", "robot1", DESK]}
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".out")] == []


def test_failed_run_leaves_old_bundles_unchanged(
    make: Make,
    source: Path,
    keys: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    make()
    before = {name: version(tmp_path / "out", name) for name in ROBOTS}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(bundle, "release_id", full)
    source.write_text(TEXT.replace("speed = 0.05", "speed = 0.06"))
    assert main(command(source, keys, tmp_path / "out")) == 2
    assert "No space left on device; its content is unchanged" in capsys.readouterr().err
    assert {name: version(tmp_path / "out", name) for name in ROBOTS} == before
    assert {path.name for path in tmp_path.iterdir()} == {"secrets", "out", source.name}


def command(source: Path, keys: Path, out: Path, *flags: str) -> list[str]:
    words = ["deploy", "bundle", source, "--certificates", keys, "--out", out, *flags]
    return [str(word) for word in words]


def test_command_prints_releases_and_next_commands(
    source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out of doors"
    assert main(command(source, keys, out)) == 0
    output = capsys.readouterr().out
    for robot in ROBOTS:
        assert f"{robot:<16}{version(out, robot)['release']}" in output
    next_ones = [shlex.split(line) for line in output.splitlines() if line.startswith("  formation")]
    assert [words[1:] for words in next_ones] == [
        ["deploy", "push", str(out)],
        ["leader", str(out), "--hold"],
        ["monitor", str(out)],
        ["order", str(out), "run"],
        ["stop", str(out)],
    ]
    assert load(out) == parse(TEXT)
    for process in ("leader", "monitor", "operator"):
        assert configuration_of(out, process) == out / DESK / f"{process}.json5"
    assert main(command(source, keys, out, "--json", "--platform", "x86_64", "--python", "3.11")) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["platform"], result["python"]) == ("x86_64", "3.11")
    assert set(result["releases"]) == set(ROBOTS)


def test_flag_no_wheels_is_recorded_in_version_file(source: Path, keys: Path, tmp_path: Path) -> None:
    assert main(command(source, keys, tmp_path / "out", "--no-wheels")) == 0
    assert version(tmp_path / "out", "robot1")["wheels"] is False
    wheel = tmp_path / "out" / "robot1" / "wheels" / "zenoh_formation-0.1.0-py3-none-any.whl"
    assert "False" in wheel.read_text()


@pytest.mark.parametrize(
    ("change", "output"),
    [
        (('endpoint = "tls/10.77.0.2:7460"', ""), "robot1 without endpoint; in the field every robot"),
        (('endpoint = "tls/10.77.0.2:7460"', 'endpoint = "tcp/10.77.0.2:7460"'), "must begin with 'tls/'"),
        (('robot_endpoint = "tcp/127.0.0.1:7447"', ""), "robot_endpoint of robot1 is missing; it must be"),
        (("tcp/127.0.0.1:7447", "tcp/10.77.0.2:7447"), "on the robot itself and for nothing else"),
        (("robot1", "desk"), "no robot or standby can be called 'desk'"),
        (("robot1", "operator"), "no robot of the field can be called 'operator'"),
    ],
    ids=[
        "no endpoint",
        "no tls",
        "no bridge",
        "bridge of another computer",
        "robot called desk",
        "robot called operator",
    ],
)
def test_mission_unfit_for_field_is_refused(
    keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: tuple[str, str], output: str
) -> None:
    source = tmp_path / "changed.toml"
    source.write_text(TEXT.replace(*change))
    assert main(command(source, keys, tmp_path / "out")) == 2
    error = capsys.readouterr().err
    assert output in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_missing_or_mismatched_certificate_is_refused(
    source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(source, tmp_path / "nowhere", tmp_path / "out")) == 2
    output = capsys.readouterr().err
    assert "no certificate for leader; `formation deploy certificates MISSION --out" in output
    assert "nowhere` issues one" in output
    source.write_text(TEXT.replace("robot2", "robot4"))  # a robot without a certificate
    assert main(command(source, keys, tmp_path / "out")) == 2
    assert "no certificate for robot4; `formation deploy" in (output := capsys.readouterr().err)
    assert f"--out {keys} --renew` issues one" in output
    source.write_text(TEXT)
    (keys / "robot2" / "key.pem").write_text((keys / "robot1" / "key.pem").read_text())
    assert main(command(source, keys, tmp_path / "out")) == 2
    assert "is not the key of" in capsys.readouterr().err


def test_expired_certificate_is_refused(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "old"
    certificates.create(mission(), keys, days=1.0, authority_days=9.0, now=NOW - timedelta(days=2))
    assert main(command(source, keys, tmp_path / "out")) == 2
    assert "leader/certificate.pem: has expired on" in capsys.readouterr().err


def test_certificate_for_another_address_is_refused(
    keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "elsewhere.toml"
    source.write_text(TEXT.replace("10.77.0.3", "10.88.0.3"))
    assert main(command(source, keys, tmp_path / "out")) == 2
    output = capsys.readouterr().err
    assert "is for robot2 at 10.77.0.3, and in mission three-in-a-row it listens at 10.88.0.3" in output


def test_certificates_of_two_authorities_are_refused(
    source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = secrets(tmp_path / "other")
    (keys / "robot2").rename(tmp_path / "aside")
    (other / "robot2").rename(keys / "robot2")
    assert main(command(source, keys, tmp_path / "out")) == 2
    assert "robot2: trusts another authority than leader does" in capsys.readouterr().err


@pytest.mark.parametrize("foreign", ["thesis.tex", "robot9", "robot1"])
def test_folder_with_foreign_file_is_refused_and_unchanged(
    source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], foreign: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / foreign).touch()
    assert main(command(source, keys, out)) == 2
    assert f"holds {foreign}, which is in no bundle; name a new folder" in capsys.readouterr().err
    assert {path.name for path in out.iterdir()} == {foreign}


def test_foreign_file_among_bundles_is_refused_and_kept(
    make: Make, source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make()
    note = tmp_path / "out" / "notes.txt"
    note.touch()
    assert main(command(source, keys, tmp_path / "out")) == 2
    assert "holds notes.txt" in capsys.readouterr().err
    assert note.exists()


def test_unwritable_output_folder_is_refused(
    source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert main(command(source, keys, tmp_path / "file")) == 2
    assert "file is a file, and no folder" in capsys.readouterr().err


def test_illegal_unit_name_is_refused_before_wheels_are_fetched(
    source: Path, keys: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched = []
    monkeypatch.setattr(wheels, "collect", lambda *_, **__: fetched.append(1))
    for flag in ("--bringup", "--bridge"):
        assert main(command(source, keys, tmp_path / "out", flag, "ros2 launch")) == 2
    assert not fetched


def test_unsupported_platform_python_and_bringup_are_refused(
    source: Path, keys: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for flag, value, legal in (
        ("--python", "3.10", "3.11"),
        ("--platform", "armv7l", "aarch64"),
        ("--bringup", "ros2 launch", "turtlebot3.service"),
    ):
        assert main(command(source, keys, tmp_path / "out", flag, value)) == 2
        output = capsys.readouterr().err
        assert value in output
        assert legal in output
