"""What the README says is true."""

from __future__ import annotations

import re
from pathlib import Path

from deploy.cli import COMMANDS
from formation.mission_file import shipped
from formation.topics import markdown

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_topic_table_is_the_one_in_the_code() -> None:
    table = re.search(r"<!-- topics: begin -->\n(.*)<!-- topics: end -->", README, re.DOTALL)
    assert table is not None
    assert table[1] == markdown()


def test_every_file_it_points_to_exists() -> None:
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    assert links
    assert not [link for link in links if not (ROOT / link).exists()]


def test_every_command_and_mission_it_names_exists() -> None:
    commands = set(re.findall(r"`formation ([a-z]+)", README))
    assert commands <= set(COMMANDS)
    assert {"run", "check", "simulate", "order"} <= commands
    for name in shipped():
        assert f"`{name}`" in README


def test_ci_runs_the_line_that_the_readme_gives_for_the_tests() -> None:
    (line,) = re.findall(r"^python3 deploy/env\.py pytest$", README, re.MULTILINE)
    assert line in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
