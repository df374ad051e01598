"""The page of one run or two: a single file that loads nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from importlib.resources import files
from typing import Any, NamedTuple

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from formation.monitor.exporters import layout
from formation.monitor.recording.channels import VERSIONS
from formation.monitor.report import figures, summary, tables, words
from formation.monitor.report.gather import Run
from formation.monitor.report.parts import PANELS, Panel, View
from formation.monitor.report.summary import items, notices, verdict

CARDS = (
    "settling_time", "formation_error", "formation_error_true", "error_rms_settled", "error_max_settled",
    "answer_median", "missed", "rejected", "messages", "duration",
)  # fmt: skip
"""Numbers shown at the top."""
MAX_RECOLOURED_FOLLOWERS = len(layout.COLOURS)
"""Most followers with colours for a dark page; with more, the figure's background stays white."""
MAX_DIFFERENCES = 12
"""Number of differences of two missions that are listed."""
CAPTIONS = {
    "graph": "Measurements: an arrow from each robot to its neighbours, in the formation's shape.",
    "trajectories": "Paths of the axle centres, the leader's dotted; the formation at four moments.",
    "heading_errors": "Estimated less true heading of each follower.",
    "formation_error": "Sum over all edges of |z_ij − z*_ij|, with the mission's bound.",
    "forward_speeds": "Commanded forward speeds and their limits (dashed); the leader's speed, dotted.",
    "turn_rates": "Commanded turn rates and their limits (dashed).",
    "robot_errors": "Each follower's part of the formation error.",
}
COLOURS = {
    "#000000": "var(--ink)",
    "#ffffff": "var(--sheet)",
    "#e4e4e4": "var(--grid)",
    "#707070": "var(--faint)",
    "#606060": "var(--faint)",
    "#1f4e79": "var(--formation)",
}
"""Colours of a figure on paper, and those on a page that may be dark."""
_ID = re.compile(r'\sid="([^"]*)"')
_USE = re.compile(r'(?:xlink:href="|href="|url\()#([^")]+)')


class ReportedRun(NamedTuple):
    """A run, with results from elsewhere."""

    run: Run
    check: str
    """Output of `formation check` for its mission."""


class Drawn(NamedTuple):
    """A figure on the page."""

    svg: Markup
    caption: str
    wide: bool
    """Whether it spans both columns."""
    paper: bool
    """Whether its background stays white."""


def page(reported: Sequence[ReportedRun], until: float | None = None, made: str = "") -> str:
    """Return the page of one run, or of two side by side; `until` [s] is the last moment of the panels.

    `made` is the time of writing, for the last line.
    """
    runs = [one.run for one in reported]
    view = View.of(runs, until)
    here = files("formation.monitor.report")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    names = labels(runs)
    several = len(runs) > 1
    return environment.from_string(here.joinpath("page.html").read_text("utf-8")).render(
        title=f"{' and '.join(names)}: report",
        heading=" and ".join(names) if several else names[0],
        lead=summary.comparison(*runs) if several else verdict(runs[0]),
        subtitle="; ".join(f"recorded {_when(run)}, {words.lasting(run.duration)}" for run in runs),
        notices=[] if several else list(notices(runs[0])),
        compared=_compared(runs, names, view) if several else None,
        runs=[_run(one, name, view, several) for one, name in zip(reported, names, strict=True)],
        terms=tables.TERMS,
        style=Markup(here.joinpath("page.css").read_text("utf-8")),  # noqa: S704 - ours
        version=version("zenoh-formation"),
        made=made,
    )


def labels(runs: Sequence[Run]) -> list[str]:
    """Return each run's label: mission and law, and a letter if there are two."""
    names = [f"{run.mission.name}, {run.mission.law.kind} law" for run in runs]
    if len(runs) == 1:
        return names
    return [f"{letter}: {name}" for letter, name in zip("AB", names, strict=True)]


def _when(run: Run) -> str:
    if not run.messages:
        return run.recording.about.get("recorded_at", "at an unknown time")
    return f"{datetime.fromtimestamp(run.begin, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _compared(runs: Sequence[Run], names: Sequence[str], view: View) -> dict[str, Any]:
    first, second = runs
    by_name = dict(zip(names, runs, strict=True))
    verdicts = " ".join(f"{name}: {verdict(run)}" for name, run in by_name.items())
    text = f"Formation errors of both runs on a logarithmic scale. {verdicts}"
    caption = "Both formation errors on the same axes."
    different = summary.differences(first.mission, second.mission)
    if (more := len(different) - MAX_DIFFERENCES) > 0:
        different = [*different[:MAX_DIFFERENCES], f"… and {more} more"]
    heads = ("", *names, "ratio B : A")
    robots = list(summary.compared_robots(first, second))
    return {
        "different": different,
        "overlay": _drawn(figures.overlay(by_name, view), "overlay", text, caption, first, wide=True),
        "numbers": tables.Table("In numbers", heads, list(summary.compared_items(first, second))),
        "robots": tables.Table("RMS error of each robot, whole run", heads, robots),
        "panels": [
            [
                _panel(run, view, which, f"{letter.lower()}-{which.name}", f"{letter}: ")
                for run, letter in zip(runs, "AB", strict=True)
            ]
            for which in PANELS[1:]
        ],
    }


def _run(reported: ReportedRun, name: str, view: View, several: bool) -> dict[str, Any]:
    run = reported.run
    letter = name[0].lower() if several else "a"
    numbers = {item.name: item for item in items(run)}
    return {
        "name": name,
        "mark": f"{letter.upper()}: " if several else "",
        "verdict": verdict(run),
        "notices": list(notices(run)),
        "cards": [
            numbers[name] for name in CARDS if name != "formation_error_true" or run.true_error.whole.count
        ],
        "panels": [] if several else [_panel(run, view, which, which.name) for which in PANELS],
        "whole": _whole(run, letter),
        "robots": tables.robots(run),
        "topics": tables.topics(run),
        "answers": tables.answers(run),
        "rejected": tables.rejected(run),
        "each_key": tables.keys(run),
        "orders": tables.orders(run),
        "leader_terms": tables.leader_terms(run),
        "activities": tables.activities(run),
        "events": tables.events(run),
        "check": reported.check,
        "file": run.recording.about["mission_file"],
        "facts": list(_facts(run)),
    }


def _facts(run: Run) -> Iterator[tuple[str, str]]:
    recording, about = run.recording, run.recording.about
    parts = recording.parts
    yield ("file" if len(parts) == 1 else f"{len(parts)} parts"), ", ".join(part.name for part in parts)
    yield "size", words.size(sum(part.stat().st_size for part in parts))
    yield "state", run.condition.words or "whole"
    yield "recorded", _when(run)
    yield "duration", words.lasting(run.duration)
    yield "messages", words.whole(run.messages)
    yield "law", run.mission.law.kind
    yield "mission fingerprint", run.mission.fingerprint
    yield "versions", ", ".join(f"{name} {about[name]}" for name in VERSIONS if about.get(name))


def _panel(run: Run, view: View, which: Panel, name: str, mark: str = "") -> Drawn:
    return _drawn(
        figures.panel(run, view, which), name, _alt(run, view, which), f"{mark}{CAPTIONS[which.name]}", run
    )


def _whole(run: Run, letter: str) -> Drawn | None:
    if not run.messages:
        return None
    text = f"Formation error over the whole recording of {words.lasting(run.duration)}. {verdict(run)}"
    caption = (
        "The whole recording, with the leader's orders, and which candidate led. Where it is thinned, least"
        " and greatest are shown."
    )
    return _drawn(figures.whole(run), f"{letter}-whole", text, caption, run, wide=True)


def _drawn(figure: Any, name: str, text: str, caption: str, run: Run, *, wide: bool = False) -> Drawn:
    plain = len(run.mission.followers) > MAX_RECOLOURED_FOLLOWERS
    source = figures.written(figure, "svg").decode()
    return Drawn(Markup(inline(source, name, text, recolour=not plain)), caption, wide, plain)  # noqa: S704 - ours


def _alt(run: Run, view: View, which: Panel) -> str:
    """Return the text alternative of a panel."""
    over = f"over {view.until:g} s"
    if which.name == "graph":
        names, robots = run.mission.followers[:12], run.mission.robots
        edges = "; ".join(f"{name} measures {', '.join(robots[name].neighbours)}" for name in names)
        return f"Graph of {len(run.mission.names)} robots. {edges}."
    if which.name == "heading_errors" and not run.truth:
        return "Heading errors are not known: no ground truth was recorded."
    if which.name == "formation_error":
        greatest = words.length(run.error.whole.maximum)
        return f"Formation error {over}, on a logarithmic scale: {greatest} at most. {verdict(run)}"
    if which.name in {"forward_speeds", "turn_rates"}:
        index = 0 if which.name == "forward_speeds" else 1
        shares = ", ".join(
            f"{name} {words.share(robot.saturated[index])}" for name, robot in list(run.robots.items())[:12]
        )
        return f"{CAPTIONS[which.name]} {over.capitalize()}. Share of commands at the limit: {shares}."
    return f"{CAPTIONS[which.name]} {over.capitalize()}."


def inline(svg: str, name: str, text: str, *, recolour: bool = True) -> str:
    """Return an SVG file as an element of a page; `name` is unique on it, `text` describes the figure."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", body, flags=re.DOTALL)
    used = set(_USE.findall(body))
    body = _ID.sub(lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", body)
    body = re.sub(r'((?:xlink:href="|href="|url\()#)', rf"\g<1>{name}-", body)
    if recolour:
        body = re.sub("|".join(COLOURS), lambda found: COLOURS[found[0]], body)
    box = re.search(r'viewBox="[^"]*"', body)
    opening = f'<svg {box[0] if box else ""} role="img" aria-label="{escape(text)}">'
    return re.sub(r"<svg[^>]*>", lambda _: opening, body, count=1)
