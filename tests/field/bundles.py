"""Bundles of a small team with a minimal install.sh; robots are folders behind one ssh server."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main
from tests.field.sshd import Server

ROBOTS = ("robot1", "robot2", "robot3")
MISSION = """
name = "pair"
leader = "leader"
route = [{ speed = 0.05, heading_deg = 0 }]
[shapes.line]
robot1 = [-1.0, 0.0]
robot2 = [-2.0, 0.0]
robot3 = [-3.0, 0.0]
[robots.leader]
start = { x = 0.0, y = 0.0 }
[robots.robot1]
neighbours = ["leader"]
endpoint = "tls/127.0.0.1:7461"
start = { x = -1.0, y = 0.0 }
[robots.robot2]
neighbours = ["robot1"]
endpoint = "tls/127.0.0.1:7462"
start = { x = -2.0, y = 0.0 }
[robots.robot3]
neighbours = ["robot2"]
endpoint = "tls/127.0.0.1:7463"
start = { x = -3.0, y = 0.0 }
"""
INSTALL = """#!/bin/sh
set -eu
while [ $# -gt 0 ]; do case "$1" in --prefix) prefix=$2; shift ;; esac; shift; done
release=$(sed 's/.*"release": "\\([^"]*\\)".*/\\1/' VERSION.json)
old=$(readlink "$prefix/current" || true)
mkdir -p "$prefix/releases/$release"
cp -pR . "$prefix/releases/$release"
[ -z "$old" ] || [ "$old" = "releases/$release" ] || ln -sfn "$old" "$prefix/previous"
ln -sfn "releases/$release" "$prefix/.next"
mv -T "$prefix/.next" "$prefix/current"
echo "installed $release"
"""
BROKEN = "#!/bin/sh\necho 'making the environment'\necho 'no wheel fits this Python' >&2\nexit 3\n"
WHEEL = bytes(range(256)) * 400


class Field:
    """A folder of bundles, and a folder with the prefix of each robot."""

    def __init__(self, folder: Path, server: Server) -> None:
        self.bundles, self._places, self.server = folder / "field", folder / "robots", server
        for name in ROBOTS:
            self.bundle(name, "r1")

    def bundle(self, name: str, release: str, install: str = INSTALL) -> Path:
        """Make a robot's bundle, or replace it; return its folder."""
        folder = self.bundles / name
        (folder / "wheels").mkdir(parents=True, exist_ok=True)
        version = {"release": release, "robot": name, "formation": "0.1.0", "mission": "pair"}
        (folder / "VERSION.json").write_text(json.dumps(version), encoding="utf-8")
        (folder / "install.sh").write_text(install, encoding="utf-8")
        (folder / "mission.toml").write_text(MISSION + f"# {release}\n", encoding="utf-8")
        (folder / "wheels" / "numpy.whl").write_bytes(WHEEL)
        key = folder / "robot.key"
        key.touch(mode=0o600)
        key.write_text(f"secret of {name}\n", encoding="utf-8")
        return folder

    def note(self, name: str, **facts: str) -> None:
        """Put these facts into the VERSION.json of a robot's bundle."""
        path = self.bundles / name / "VERSION.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **facts}), encoding="utf-8")

    def prefix(self, name: str) -> Path:
        return self._places / name

    def current(self, name: str) -> str | None:
        link = self.prefix(name) / "current"
        return link.readlink().name if link.is_symlink() else None

    def words(self, *more: str) -> list[str]:
        where = [] if "--prefix" in more else ["--prefix", str(self._places / "{robot}")]
        return [str(self.bundles), *where, "--no-systemd", *self.server.options, *more]

    def deploy(self, command: str, *more: str) -> int:
        return main(["deploy", command, *self.words(*more)])


def result(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """The JSON object that a command has just printed."""
    output: dict[str, Any] = json.loads(capsys.readouterr().out)
    return output
