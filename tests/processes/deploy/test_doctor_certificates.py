"""The doctor reads certificates and dials agents: real files and real TLS handshakes."""

from __future__ import annotations

import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from formation.deploy.cli import main
from formation.deploy.doctor import tls
from formation.deploy.doctor.tls import Credentials, context, dial
from formation.deploy.fleet import authority
from formation.deploy.fleet.authority import Pair
from formation.deploy.refusal import Refusal
from tests.support.child import PATIENCE, free_endpoint

NOW = datetime.now(UTC)
HERE = "127.0.0.1"


@pytest.fixture(scope="module")
def root() -> Pair:
    return authority.new_authority("formation pair", 365.0, NOW - timedelta(days=100))


def credentials(
    folder: Path, root: Pair, name: str = "robot1", *, days: float = 30.0, ago: float = 0.0
) -> Credentials:
    """Certificate and key of a process, issued `ago` days ago for `days`."""
    pair = authority.issue(root, name, HERE, days, NOW - timedelta(days=ago))
    home = folder / name
    home.mkdir()
    (home / "ca.pem").write_bytes(root.certificate_pem)
    (home / "certificate.pem").write_bytes(pair.certificate_pem)
    (home / "key.pem").touch(mode=0o600)
    (home / "key.pem").write_bytes(pair.key_pem)
    return Credentials(home / "ca.pem", home / "certificate.pem", home / "key.pem")


def test_read_returns_name_validity_and_key_mode(tmp_path: Path, root: Pair) -> None:
    read = tls.read("robot1", credentials(tmp_path, root))
    assert read is not None
    assert (read.name, read.wanted, read.problem, read.mode) == ("robot1", "robot1", "", 0o600)
    assert read.ends == pytest.approx((NOW + timedelta(days=30)).timestamp(), abs=1.0)
    assert read.begins == pytest.approx((NOW - authority.EARLY).timestamp(), abs=1.0)


@pytest.mark.parametrize("ago", [60.0, -10.0])
def test_read_accepts_expired_or_future_certificate(tmp_path: Path, root: Pair, ago: float) -> None:
    read = tls.read("robot1", credentials(tmp_path, root, ago=ago))
    assert read is not None
    assert (read.name, read.problem) == ("robot1", "")
    assert (read.begins <= NOW.timestamp() < read.ends) is False


def test_read_accepts_client_only_certificate(tmp_path: Path, root: Pair) -> None:
    mine = credentials(tmp_path, root, "operator")
    pair = authority.issue(root, "operator", None, 30.0, NOW)
    mine.certificate.write_bytes(pair.certificate_pem)
    mine.key.write_bytes(pair.key_pem)
    read = tls.read("operator", mine)
    assert read is not None
    assert (read.name, read.problem) == ("operator", "")


def test_read_names_problem_of_unusable_certificate(tmp_path: Path, root: Pair) -> None:
    mine = credentials(tmp_path, root)
    other = credentials(tmp_path, root, "robot2")
    (tmp_path / "rogue").mkdir()
    rogue = credentials(tmp_path / "rogue", authority.new_authority("formation pair", 365.0, NOW))

    def problem(one: Credentials) -> str:
        read = tls.read("robot1", one)
        assert read is not None
        return read.problem

    assert problem(mine._replace(key=other.key)) == "the key does not belong to it"
    assert problem(rogue._replace(trusted=mine.trusted)).startswith("its authority does not vouch for it")
    assert problem(mine._replace(key=mine.key.with_name("gone"))).endswith("gone is missing")
    mine.certificate.write_text("no certificate", encoding="utf-8")
    assert problem(mine).endswith("is damaged")
    mine.key.write_text("no key", encoding="utf-8")
    assert problem(other._replace(key=mine.key)).endswith("is damaged")


def test_order_names_certificate_other_than_operators(
    tmp_path: Path, root: Pair, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, reported in (("monitor", True), ("operator", False)):
        mine = credentials(tmp_path, root, name)
        config = tmp_path / f"{name}.json5"
        config.write_text(
            f"{{transport: {{link: {{tls: {{root_ca_certificate: '{mine.trusted}', "
            f"connect_certificate: '{mine.certificate}', connect_private_key: '{mine.key}'}}}}}}}}",
            encoding="utf-8",
        )
        flags = ["-c", str(config), "--timeout", "0.2", "-e", f"tls/{HERE}:9"]
        assert main(["order", "turtlebot3_pair", "stop", *flags]) == 1
        assert ("has the certificate of 'monitor'" in capsys.readouterr().out) is reported


def test_papers_are_found_in_configuration_and_in_folder(tmp_path: Path, root: Pair) -> None:
    mine = credentials(tmp_path, root)
    config = tmp_path / "zenoh.json5"
    config.write_text(
        f"// as it is made\n{{transport: {{link: {{tls: {{root_ca_certificate: '{mine.trusted}', "
        f"connect_certificate: '{mine.certificate}', connect_private_key: '{mine.key}'}}}}}}}}",
        encoding="utf-8",
    )
    assert tls.credentials_of(config) == mine
    config.write_text("{mode: 'peer'}", encoding="utf-8")
    assert tls.credentials_of(config) is None
    assert tls.credentials_in(tmp_path, ["robot1", "robot2"]) == {"robot1": mine}
    with pytest.raises(Refusal, match="holds none"):
        tls.credentials_in(tmp_path / "robot1", ["robot1"])
    with pytest.raises(Refusal, match=r"nowhere\.json5"):
        tls.credentials_of(tmp_path / "nowhere.json5")


@pytest.fixture
def long_refusal_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait long for a refusal: the tests check its content, not its delay."""
    monkeypatch.setattr("formation.deploy.doctor.tls.LATE_REFUSAL_TIME", PATIENCE)


@contextmanager
def served(answer: ssl.SSLContext | bytes | None) -> Iterator[str]:
    """Server that answers one connection with TLS, with bytes or not at all; yields its address and port."""
    with socket.create_server((HERE, 0)) as server:

        def greet() -> None:
            link, _ = server.accept()
            with link:
                if isinstance(answer, bytes):
                    link.sendall(answer)
                elif answer is not None:
                    try:
                        with answer.wrap_socket(link, server_side=True) as secure:
                            secure.settimeout(20.0)
                            secure.recv(1)  # until the peer has closed
                    except OSError:
                        return
                else:
                    link.settimeout(20.0)
                    while link.recv(4096):
                        pass

        greeting = threading.Thread(target=greet, daemon=True)
        greeting.start()
        yield f"{HERE}:{server.getsockname()[1]}"
        greeting.join(20.0)


def test_reach_returns_name_of_trusted_peer(tmp_path: Path, root: Pair) -> None:
    mine, theirs = credentials(tmp_path, root), credentials(tmp_path, root, "robot2")
    with served(context(theirs, server=True)) as where:
        reached = dial(f"tls/{where}", mine)
    assert (reached.outcome, reached.name) == ("ok", "robot2")


@pytest.mark.usefixtures("long_refusal_wait")
def test_reach_distinguishes_causes_of_failure(tmp_path: Path, root: Pair) -> None:
    (tmp_path / "rogue").mkdir()
    mine, theirs = credentials(tmp_path, root), credentials(tmp_path, root, "robot2")
    rogue = credentials(tmp_path / "rogue", authority.new_authority("formation pair", 365.0, NOW), "robot2")
    with served(context(rogue, server=True)) as where:
        assert dial(f"tls/{where}", mine).outcome == "untrusted"
    with served(context(theirs, server=True)) as where:
        turned_away = dial(f"tls/{where}", rogue._replace(trusted=theirs.trusted))
    assert (turned_away.outcome, turned_away.detail) == ("turned away", "unknown ca")
    with served(b"HTTP/1.1 400 Bad Request\r\n\r\n") as where:
        assert dial(f"tls/{where}", mine).outcome == "no TLS"
    assert dial(free_endpoint(), None).outcome == "refused"
    assert dial("tls/robot9.invalid:7460", mine).outcome == "unknown name"


@pytest.mark.usefixtures("long_refusal_wait")
def test_reach_reports_expired_certificate_of_either_side(tmp_path: Path, root: Pair) -> None:
    (tmp_path / "old").mkdir()
    good, late = credentials(tmp_path, root), credentials(tmp_path / "old", root, ago=40.0)
    with served(context(good, server=True)) as where:
        reached = dial(f"tls/{where}", late)
    assert (reached.outcome, reached.detail) == ("turned away", "certificate expired")
    with served(context(late, server=True)) as where:
        reached = dial(f"tls/{where}", good)
    assert (reached.outcome, reached.detail) == ("untrusted", "certificate has expired")


def test_reach_times_out_on_silent_peer(tmp_path: Path, root: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("formation.deploy.doctor.tls.CONNECT_TIMEOUT_SECONDS", 0.2)
    with served(None) as where:
        assert dial(f"tls/{where}", credentials(tmp_path, root)).outcome == "no answer"


def test_read_returns_none_for_unreadable_key(
    tmp_path: Path, root: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("formation.deploy.doctor.tls.context", forbidden)  # as root can read every file
    assert tls.read("robot1", credentials(tmp_path, root)) is None
