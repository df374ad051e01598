"""Files of the live page: local, documented, and with the hashes in their README."""

from __future__ import annotations

import re
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import pytest

from formation.monitor.web.routes import SITE

VENDOR = SITE / "vendor"
OWN = [path for path in sorted(SITE.rglob("*")) if path.is_file() and VENDOR not in path.parents]


class References(HTMLParser):
    """Everything that a browser loads for a document."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.inline: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        named = dict(attributes)
        if tag in {"script", "link", "img"}:
            self.found.append(named.get("src") or named.get("href") or f"nothing, by a {tag}")
        self.inline += [name for name in named if name == "style" or name.startswith("on")]


def test_vendor_files_match_hashes_in_readme() -> None:
    result = dict(re.findall(r"\| `(\S+)` \| `([0-9a-f]{64})` \|", (VENDOR / "README.md").read_text()))
    there = {path.name: sha256(path.read_bytes()).hexdigest() for path in VENDOR.iterdir()}
    assert there.pop("README.md")
    assert result == there
    assert b"v1.6.32" in (VENDOR / "uPlot.iife.min.js").read_bytes()[:100]


def test_page_loads_only_files_of_the_site() -> None:
    page = References((SITE / "index.html").read_text())
    assert page.found
    assert not [name for name in page.found if not (SITE / name).is_file()]
    assert page.inline == []  # which the page's policy forbids


@pytest.mark.parametrize("path", OWN, ids=lambda path: path.name)
def test_page_files_contain_no_external_urls(path: Path) -> None:
    text = path.read_text().replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?:|[\"'(]//\w", text)


@pytest.mark.parametrize("path", [path for path in OWN if path.suffix == ".js"], ids=lambda path: path.name)
def test_scripts_are_documented_short_and_import_existing_files(path: Path) -> None:
    text = path.read_text()
    assert text.startswith("/**")
    assert text.count("\n") <= 250
    for other in re.findall(r"from \"\./(\S+)\"", text):
        assert (path.parent / other).is_file()
