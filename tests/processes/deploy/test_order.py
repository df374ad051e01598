"""Orders in the field: an operator with a certificate, robots that answer to nobody else."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from formation.deploy.fleet import access, certificates
from formation.deploy.fleet.access import OPERATOR
from formation.mission.file import parse, read
from tests.support.child import PATIENCE, free_endpoint, started

pytestmark = pytest.mark.processes
EVERYONE = {"leader", "robot1", "robot2"}


class Field:
    """The pair in the field: everybody under certificates, as deployed, but on this machine."""

    def __init__(self, folder: Path) -> None:
        text, source = read("turtlebot3_pair")
        for name in sorted(EVERYONE):
            end = free_endpoint().replace("tcp/", "tls/")
            text = text.replace(f"[robots.{name}]", f'[robots.{name}]\nendpoint = "{end}"')
        self.file = folder / "field.toml"
        self.file.write_text(text)
        self.mission, self.secrets = parse(text, source), folder / "secrets"
        certificates.create(self.mission, self.secrets, days=1.0, authority_days=2.0, now=datetime.now(UTC))
        self.configurations = {}
        for name in access.processes(self.mission):
            settings = access.configuration(self.mission, name, self.secrets / name)
            self.configurations[name] = folder / f"{name}.json5"
            self.configurations[name].write_text(access.text(self.mission, name, settings))

    def command(self, module: str, name: str, *flags: str) -> list[str]:
        return [module, str(self.file), *flags, "-c", str(self.configurations[name])]


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Field]:
    """The leader and both agents, ready; nobody drives, for there are no robots."""
    field = Field(tmp_path_factory.mktemp("field"))
    with ExitStack() as stack:
        commands = [field.command("formation.leader", "leader")]
        commands += [
            field.command("formation.agent", name, "--robot", name) for name in field.mission.followers
        ]
        for child in [stack.enter_context(started(*command)) for command in commands]:
            child.event("ready")
        yield field


class Given(NamedTuple):
    code: int
    report: dict[str, Any]
    words: str


def order(field: Field, do: str, *flags: str) -> Given:
    """`formation order` as an operator types it."""
    command = [sys.executable, "-m", "formation.deploy", "order", str(field.file), do, "--json", *flags]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.stdout, done.stderr
    return Given(done.returncode, json.loads(done.stdout), done.stderr)


def test_all_robots_obey_the_operators_configuration(field: Field) -> None:
    operator = ("-c", str(field.configurations[OPERATOR]))
    robots = EVERYONE - {field.mission.leader}
    for do in ("stop", "release", "hold", "run"):
        given = order(field, do, *operator)
        assert given.report["missing"] == [], given.words
        if do in {"stop", "hold"}:  # these agents have no robot, which cannot stand for them
            assert (given.code, set(given.report["unreached"])) == (1, robots), given.words
        else:
            assert (given.code, given.report["refused"]) == (0, []), given.words
            assert {answer["robot"] for answer in given.report["acknowledged"]} == EVERYONE


def test_an_endpoint_on_the_command_line_outranks_those_of_the_file(field: Field) -> None:
    operator = ("-c", str(field.configurations[OPERATOR]))
    end = free_endpoint().replace("tcp/", "tls/")
    given = order(field, "release", *operator, "-e", end, "--timeout", "1.5")
    assert (given.code, given.report["acknowledged"]) == (1, [])


def test_order_without_certificate_explains_missing_option(field: Field) -> None:
    given = order(field, "stop", "--timeout", "1.5")
    assert (given.code, set(given.report["missing"])) == (1, EVERYONE)
    assert "-c FILE" in given.words


def test_a_robots_certificate_is_no_operators(field: Field, tmp_path: Path) -> None:
    settings = access.configuration(field.mission, OPERATOR, field.secrets / "robot1")
    (tmp_path / "thief.json5").write_text(access.text(field.mission, OPERATOR, settings))
    given = order(field, "stop", "--timeout", "1.5", "-c", str(tmp_path / "thief.json5"))
    assert (given.code, given.report["acknowledged"]) == (1, [])
