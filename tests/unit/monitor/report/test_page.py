"""The report page as text: complete and self-contained."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from formation.mission.file import read
from formation.monitor.report import figures, words
from formation.monitor.report.page import ReportedRun, inline, page
from formation.monitor.report.summary import differences
from tests.support.examples import slow
from tests.support.missions import edited
from tests.support.monitored import Fleet
from tests.support.recordings import coming_in, gathered, record, talk

TEXT = read("six_robots")[0]


class Read(HTMLParser):
    """Parse a page like a browser: closed tags, ids, headings, pictures, and what it would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: Counter[str] = Counter()
        self.loads: list[str] = []
        self.heads: list[str] = []
        self.images: list[str] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_startendtag(tag, attrs)
        if tag not in {"meta", "link", "br", "img"}:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in {"h1", "h2", "h3"}:
            self.heads.append(tag)
        if tag == "svg":
            assert values["role"] == "img"
            self.images.append(values["aria-label"] or "")
        self.ids.update(filter(None, [values.get("id")]))
        targets = (values.get(name) or "#" for name in ("src", "href", "xlink:href", "action", "data"))
        self.loads += [target for target in targets if not target.startswith(("#", "data:"))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    record(folder / "field.mcap", talk(Fleet(away=coming_in), 9.0))
    record(folder / "paper.mcap", talk(Fleet(away=coming_in), 9.0, truth=False), law="paper")
    return folder


@pytest.fixture
def no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make pages without pictures, which take most of the time."""
    monkeypatch.setattr(figures, "written", lambda *_: b"<svg></svg>")


def made(folder: Path, *names: str, check: str = "", **how: Any) -> str:
    """The page of these recordings."""
    return page([ReportedRun(gathered(folder / f"{name}.mcap"), check) for name in names], **how)


@pytest.fixture(scope="module")
def one(folder: Path) -> str:
    return made(folder, "field", check="check: <nothing> speaks against it", made="today")


@pytest.fixture(scope="module")
def two(folder: Path) -> str:
    return made(folder, "field", "paper")


IMAGES = {"one": 8, "two": 1 + 2 * 6 + 2}
"""Pictures on the page of one run, and of two."""


@pytest.mark.parametrize("runs", ["one", *slow("two")])
def test_page_is_self_contained_with_unique_ids_and_picture_labels(
    runs: str, request: pytest.FixtureRequest
) -> None:
    text = request.getfixturevalue(runs)
    read = Read(text)
    assert read.loads == []
    assert {name for name, times in read.ids.items() if times > 1} == set()
    assert all(len(label) > 20 for label in read.images)
    assert read.heads[0] == "h1"
    assert read.heads.count("h1") == 1
    assert not re.search(r"<script|@import|https?://(?!www\.w3\.org)", text)
    assert set(re.findall(r"url\((?!#)", text)) == set()
    assert len(read.images) == IMAGES[runs]
    used = set(re.findall(r'(?:xlink:href="|url\()#([^")]+)', text))
    assert used
    assert used <= set(read.ids)


def test_page_contains_all_sections(one: str) -> None:
    for reported in (
        "Converged: formation error under 5 cm since", "RMS, settled", "u at its limit", "delay p50",
        "From odometry to command", "The leader&#39;s orders", "joined", "whole", "mission fingerprint",
        "[shapes.hexagon]", "check: &lt;nothing&gt; speaks against it", "eclipse-zenoh", "today",
        "formation error, settled", "Every key",
    ):  # fmt: skip
        assert reported in one


def test_picture_text_is_text_in_page_colours(one: str) -> None:
    assert re.search(r"<text[^>]*>\s*time \[s\]\s*</text>", one)
    assert "var(--ink)" in one
    assert "#000000" not in one


@pytest.mark.usefixtures("no_pictures")
def test_page_of_two_runs_compares_them_with_a_ratio(folder: Path) -> None:
    two = made(folder, "field", "paper")
    assert "A: six-robots, field law" in two
    assert "B: six-robots, paper law" in two
    assert "ratio B : A" in two
    assert "different missions" not in two
    assert "not known: no ground truth was recorded" in two


@pytest.mark.usefixtures("no_pictures")
def test_page_names_differences_between_missions(folder: Path, tmp_path: Path) -> None:
    record(tmp_path / "other.mcap", talk(Fleet(), 2.0), edited(TEXT, "law", "k_p = 3.0"))
    runs = [gathered(folder / "field.mcap"), gathered(tmp_path / "other.mcap")]
    assert differences(runs[0].mission, runs[1].mission) == ["law.k_p: 2.0 in A, 3.0 in B"]
    text = page([ReportedRun(run, "") for run in runs])
    assert "different missions" in text
    assert "law.k_p: 2.0 in A, 3.0 in B" in text


def test_different_law_is_no_mission_difference(folder: Path) -> None:
    field, paper = (gathered(folder / f"{law}.mcap").mission for law in ("field", "paper"))
    assert field != paper
    assert differences(field, paper) == []


def test_script_in_messages_does_not_reach_the_page(tmp_path: Path) -> None:
    script = b"<script>alert(1)</script>"
    bad = [one._replace(attachment=script) for one in talk(Fleet(), 1.0) if "robot1/" in one.key]
    record(tmp_path / "run.mcap", bad)
    assert "<script" not in made(tmp_path, "run", check="<script>")


@pytest.mark.slow
def test_page_is_made_of_nearly_empty_recordings(tmp_path: Path) -> None:
    samples = talk(Fleet(), 1.0)
    record(tmp_path / "empty.mcap", [])
    record(tmp_path / "unknown.mcap", [sample for sample in samples if "robot3" not in sample.key])
    record(tmp_path / "one.mcap", samples[:1])
    Read(made(tmp_path, "one"))
    Read(made(tmp_path, "empty", "unknown"))


def test_inlined_figure_has_prefixed_ids() -> None:
    source = '<?xml?><svg width="1"viewBox="0 0 9 9"><g id="a"/><g id="b"/><use xlink:href="#a"/></svg>'
    assert inline(source, "x", 'a "b"') == (
        '<svg viewBox="0 0 9 9" role="img" aria-label="a &quot;b&quot;">'
        '<g id="x-a"/><g/><use xlink:href="#x-a"/></svg>'
    )


@pytest.mark.parametrize(
    ("write", "texts"),
    [
        (words.length, {13.87: "13.9 m", 0.99951: "1.00 m", 0.0426: "4.26 cm", 0.00232: "2.32 mm",
                        1.097e-6: "1.10 µm", 1e-9: "<0.01 µm", 0.0: "0 m", None: "–", math.nan: "–"}),
        (words.bound, {0.05: "5 cm", 2.5: "2.5 m"}),
        (words.seconds, {3.600066: "3.60 s", -2.5: "−2.50 s"}),
        (words.lasting, {34.02: "34.0 s", 725.0: "12 min 5 s", 3725.0: "1 h 2 min"}),
        (words.milliseconds, {0.00231: "2.31 ms", 12.34: "12.3 s"}),
        (words.degrees, {0.0669: "3.83°"}),
        (words.share, {0.0: "0 %", 0.0001: "<0.1 %", 0.449: "44.9 %"}),
        (words.rate, {20.012: "20.0 Hz"}),
        (words.whole, {13798: "13,798"}),
        (words.size, {903_800: "903.8 kB"}),
        (words.ratio, {7.72: "× 7.72", 32253.4: "× 32,253", 0.0437: "× 0.044", 0.0001: "× <0.001",
                       0.0: "× 0"}),
    ],
)  # fmt: skip
def test_quantities_are_formatted_with_units(
    write: Callable[[float | None], str], texts: dict[float | None, str]
) -> None:
    assert {value: write(value) for value in texts} == texts
