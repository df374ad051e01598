"""Zenoh sessions of the processes of a mission in the field, and of an attacker."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import zenoh

from formation.deploy.fleet import access, certificates
from formation.mission.model import Mission
from formation.transport.bus_config import DEFAULTS, BusConfig
from formation.transport.session import settings_of
from formation.transport.wiring import named
from tests.support.namespaces import until


class Desk(NamedTuple):
    """A mission, and the folder with certificates and configurations of all processes."""

    mission: Mission
    folder: Path

    def file(self, process: str) -> Path:
        return self.folder / process / "zenoh.json5"

    def endpoint(self, name: str) -> str:
        return named(self.mission)[name] or ""


def prepared(mission: Mission, folder: Path) -> Desk:
    """Make certificates and configurations of all processes."""
    certificates.create(mission, folder, days=1.0, authority_days=1.0, now=datetime.now(UTC))
    desk = Desk(mission, folder)
    for process in access.processes(mission):
        settings = access.configuration(mission, process, folder / process)
        desk.file(process).write_text(access.text(mission, process, settings))
    return desk


class Sessions:
    """Sessions of a mission's processes, with their own configurations."""

    def __init__(self, desk: Desk, stack: ExitStack) -> None:
        self.desk, self._stack = desk, stack
        self.received: dict[str, Counter[str]] = {}
        """Number of received messages by process and key."""

    def open(self, *processes: str) -> list[zenoh.Session]:
        return [self._open(process) for process in processes]

    def _open(self, process: str) -> zenoh.Session:
        config = BusConfig(config_file=self.desk.file(process), namespace=self.desk.mission.team or "")
        return self._stack.enter_context(zenoh.open(settings_of(config)))

    def listen(self, process: str, session: zenoh.Session, *keys: str) -> None:
        received = self.received.setdefault(process, Counter())

        def receive(sample: zenoh.Sample) -> None:
            received[str(sample.key_expr)] += 1

        for key in keys:
            session.declare_subscriber(key, zenoh.handlers.Callback(receive, indirect=False))

    def answer(self, session: zenoh.Session, key: str) -> None:
        """Let a process reply to every request on `key`."""

        def reply(query: zenoh.Query) -> None:
            with query:
                query.reply(key, b"obeyed")

        session.declare_queryable(key, zenoh.handlers.Callback(reply, indirect=False))

    def reaches(self, session: zenoh.Session, key: str, process: str) -> None:
        """Publish repeatedly until `process` has received a message on `key`: links take time."""

        def result() -> bool:
            session.put(key, b"something")
            return self.received[process][key] > 0

        until(result, what=f"{process} receives {key}")

    def attacking(self, name: str, victim: str) -> AbstractContextManager[zenoh.Session]:
        """A session with the key of `name` and no access rules, linked with the victim."""
        identity = self.desk.folder / name
        victims = [self.desk.endpoint(victim)]
        return attacking(identity, victims, identity / "ca.pem", self.desk.mission.team)


@contextmanager
def attacking(
    identity: Path, victims: Sequence[str], trusted: Path, team: str | None = None
) -> Iterator[zenoh.Session]:
    """A session with the key in `identity` and no access rules, linked with `victims`.

    It is a client, which sends everything; a peer sends only what the other side subscribes to.
    """
    settings = zenoh.Config()
    for path, value in DEFAULTS:
        settings.insert_json5(path, value)
    if team:
        settings.insert_json5("namespace", f'"{team}"')
    settings.insert_json5("mode", '"client"')
    settings.insert_json5("connect/endpoints", str(list(victims)))
    for name, file in (
        ("root_ca_certificate", trusted),
        ("connect_private_key", identity / "key.pem"),
        ("connect_certificate", identity / "certificate.pem"),
    ):
        settings.insert_json5(f"transport/link/tls/{name}", f'"{file}"')
    settings.insert_json5("transport/link/tls/enable_mtls", "true")
    with zenoh.open(settings) as session:
        yield session
