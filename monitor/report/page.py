"""The page of one run or two: a single file that loads nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from importlib.resources import files
from typing import Any, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from formation.monitor.report import compare, drawing, figures, happened, svg, tables, words
from formation.monitor.report.gather import Run
from formation.monitor.report.parts import PANELS, Panel
from formation.monitor.report.summary import Item, items, notices, verdict
from formation.monitor.report.view import View

CARDS = (
    "settling_time", "formation_error", "formation_error_true", "error_rms_settled", "error_max_settled",
    "answer_median", "missed", "rejected", "messages", "duration",
)  # fmt: skip
"""Numbers shown at the top."""
MAX_RECOLOURED_FOLLOWERS = len(drawing.PALETTE)
"""Most followers with colours for a dark page; with more, the figure's background stays white."""
_PACKAGES = ("formation", "python", "eclipse-zenoh", "mcap", "numpy", "pydantic")


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
    environment = Environment(
        loader=PackageLoader("monitor", "report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    names = labels(runs)
    several = len(runs) > 1
    return environment.get_template("page.html").render(
        title=f"{' and '.join(names)}: report",
        heading=" and ".join(names) if several else names[0],
        lead=compare.verdict(*runs) if several else verdict(runs[0]),
        subtitle=_subtitle(runs),
        notices=[] if several else list(notices(runs[0], cut=runs[0].recording.is_cut())),
        compared=_compared(runs, names, view) if several else None,
        runs=[_run(one, name, view, several) for one, name in zip(reported, names, strict=True)],
        terms=tables.TERMS,
        style=Markup(files("formation.monitor.report").joinpath("page.css").read_text("utf-8")),  # noqa: S704 - ours
        version=version("zenoh-formation"),
        made=made,
    )


def labels(runs: Sequence[Run]) -> list[str]:
    """Return each run's label: mission and law, and a letter if there are two."""
    names = [f"{run.mission.name}, {run.mission.law.kind} law" for run in runs]
    if len(runs) == 1:
        return names
    return [f"{letter}: {name}" for letter, name in zip("AB", names, strict=True)]


def _subtitle(runs: Sequence[Run]) -> str:
    return "; ".join(f"recorded {_when(run)}, {words.lasting(run.duration)}" for run in runs)


def _when(run: Run) -> str:
    if not run.messages:
        return run.recording.about.get("recorded_at", "at an unknown time")
    return f"{datetime.fromtimestamp(run.begin, UTC):%Y-%m-%d %H:%M:%S} UTC"


def _compared(runs: Sequence[Run], names: Sequence[str], view: View) -> dict[str, Any]:
    first, second = runs
    different = compare.differences(first.mission, second.mission)
    heads = ("", names[0], names[1], "ratio B : A")
    overlay = _drawn(
        figures.overlay(dict(zip(names, runs, strict=True)), view),
        "overlay",
        _overlay_alt(runs, names),
        "Both formation errors on the same axes.",
        runs[0],
        wide=True,
    )
    return {
        "different": compare.shortened(different),
        "overlay": overlay,
        "numbers": tables.Table("In numbers", heads, [tuple(row) for row in compare.rows(first, second)]),
        "robots": tables.Table(
            "RMS error of each robot, whole run",
            heads,
            [tuple(row) for row in compare.robot_rows(first, second)],
        ),
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
    cut = run.recording.is_cut()
    return {
        "name": name,
        "mark": f"{letter.upper()}: " if several else "",
        "verdict": verdict(run),
        "notices": list(notices(run, cut=cut)),
        "cards": list(_cards(run, numbers)),
        "panels": [] if several else [_panel(run, view, which, which.name) for which in PANELS],
        "whole": _whole(run, letter),
        "robots": tables.robots(run),
        "topics": tables.topics(run),
        "answers": tables.answers(run),
        "rejected": tables.rejected(run),
        "each_key": tables.keys(run),
        "orders": happened.orders(run),
        "leader_terms": happened.leader_terms(run),
        "doings": happened.doings(run),
        "events": happened.events(run),
        "check": reported.check,
        "file": run.recording.about["mission_file"],
        "facts": list(_facts(run, cut=cut)),
    }


def _cards(run: Run, numbers: Mapping[str, Item]) -> Iterator[Item]:
    for name in CARDS:
        if name != "formation_error_true" or run.true_error.whole.count:
            yield numbers[name]


def _facts(run: Run, *, cut: bool) -> Iterator[tuple[str, str]]:
    """Yield the facts about the file."""
    recording, about = run.recording, run.recording.about
    parts = recording.parts
    yield ("file" if len(parts) == 1 else f"{len(parts)} parts"), ", ".join(part.name for part in parts)
    yield "size", words.size(sum(part.stat().st_size for part in parts))
    yield "state", "cut; read as far as it goes" if cut else "whole"
    yield "recorded", _when(run)
    yield "duration", words.lasting(run.duration)
    yield "messages", words.whole(run.messages)
    yield "law", run.mission.law.kind
    yield "mission fingerprint", run.mission.fingerprint
    yield "versions", ", ".join(f"{name} {about[name]}" for name in _PACKAGES if name in about)


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
    return Drawn(Markup(svg.inline(source, name, text, recolour=not plain)), caption, wide, plain)  # noqa: S704 - ours


CAPTIONS = {
    "graph": "Measurements: an arrow from each robot to its neighbours, in the formation's shape.",
    "trajectories": "Ways of the axle centres, the leader's dotted; the formation at four moments.",
    "heading_errors": "Estimated less true heading of each follower.",
    "formation_error": "Sum over all edges of |z_ij − z*_ij|, with the mission's bound.",
    "forward_speeds": "Commanded forward speeds and their limits (dashed); how fast the leader was, dotted.",
    "turn_rates": "Commanded turn rates and their limits (dashed).",
    "robot_errors": "What each follower contributes to the formation error.",
}


def _alt(run: Run, view: View, which: Panel) -> str:
    """Return the text alternative of a panel."""
    over = f"over {view.until:g} s"
    if which.name == "graph":
        edges = [
            f"{name} measures {', '.join(run.mission.robots[name].neighbours)}"
            for name in run.mission.followers[:12]
        ]
        return f"Graph of {len(run.mission.names)} robots. {'; '.join(edges)}."
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


def _overlay_alt(runs: Sequence[Run], names: Sequence[str]) -> str:
    reported = " ".join(f"{name}: {verdict(run)}" for name, run in zip(names, runs, strict=True))
    return f"Formation errors of both runs on a logarithmic scale. {reported}"
