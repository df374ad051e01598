"""Zenoh sessions as the processes of a mission have them in the field, and as somebody has who means harm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import zenoh

from deploy.field import access, certificates
from formation.mission import Mission
from formation.transport.bus_config import DEFAULTS


class Desk(NamedTuple):
    """A mission, and the folder with everybody's certificates and configuration."""

    mission: Mission
    folder: Path

    def file(self, process: str) -> Path:
        """The configuration of a process."""
        return self.folder / process / "zenoh.json5"

    def endpoint(self, robot: str) -> str:
        """Where a robot listens."""
        return self.mission.robots[robot].endpoint or ""


def prepared(mission: Mission, folder: Path) -> Desk:
    """Certificates and configurations of all processes."""
    certificates.create(mission, folder, days=1.0, authority_days=1.0, now=datetime.now(UTC))
    desk = Desk(mission, folder)
    for process in access.processes(mission):
        settings = access.configuration(mission, process, folder / process)
        desk.file(process).write_text(access.text(mission, process, settings))
    return desk


@contextmanager
def attacking(
    identity: Path, victims: Sequence[str], trusted: Path, team: str | None = None
) -> Iterator[zenoh.Session]:
    """A session with the key in `identity` and no rules of its own, linked with `victims`.

    It is a client, which sends what it is told to; a peer would first ask who wants to hear it.
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
