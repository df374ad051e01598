"""What the README and the guide say is true."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from formation.deploy.cli import COMMANDS
from formation.mission.file import shipped
from formation.topics import markdown

ROOT = Path(__file__).parents[3]
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
PAGES = [
    ROOT / "README.md",
    ROOT / "deploy" / "README.md",
    ROOT / "docs" / "README.md",
    ROOT / "docs" / "theory" / "README.md",
    ROOT / "docs" / "reference" / "topics.md",
    *GUIDE,
]


def test_topic_table_is_the_one_in_the_code() -> None:
    topics = (ROOT / "docs" / "reference" / "topics.md").read_text(encoding="utf-8")
    table = re.search(r"<!-- topics: begin -->\n(.*)<!-- topics: end -->", topics, re.DOTALL)
    assert table is not None
    assert table[1] == markdown()


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_linked_file_and_heading_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)]*)\)|<img src=\"([^\"]+)", text)
    for path, _, anchor in ((link or image).partition("#") for link, image in links):
        target = page.parent / path if path else page
        assert target.exists(), path
        if anchor:
            assert anchor in anchors(target), f"{path}#{anchor}"


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_every_page_of_the_guide_is_in_the_index() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert not [page.name for page in GUIDE if f"(guide/{page.name})" not in index]


def test_every_command_and_mission_it_names_exists() -> None:
    commands = set(re.findall(r"`formation ([a-z]+)", README))
    assert {"run", "check", "simulate", "order"} <= commands
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        blocks = "\n".join(re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
        named = re.findall(r"`formation ([a-z]+)", text)
        named += re.findall(r"^formation ([a-z]+)", blocks, re.MULTILINE)
        assert set(named) <= set(COMMANDS), page.name
    for name in shipped():
        assert f"`{name}`" in README


def test_the_router_line_of_the_guide_exports_nothing() -> None:
    guide = (ROOT / "docs" / "guide" / "real-robots.md").read_text(encoding="utf-8")
    (line,) = [line for line in guide.splitlines() if "ZENOH_CONFIG_OVERRIDE=" in line]
    assert line.endswith(" ros2 run rmw_zenoh_cpp rmw_zenohd")
    assert not line.startswith("export")


def test_ci_runs_the_line_that_the_readme_gives_for_the_tests() -> None:
    (line,) = re.findall(r"^python3 deploy/env\.py pytest$", README, re.MULTILINE)
    assert line in (ROOT / ".ci" / "run").read_text(encoding="utf-8").splitlines()
