"""`formation report`: make one page and figures for a paper from a recording, or from two side by side."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from formation.deploy import check
from formation.deploy.arguments import add_json, add_out, check_file, number, parser, print_result
from formation.deploy.refusal import Refusal, refuse_errors, refuse_os_errors
from formation.deploy.terminal.bar import Bar
from formation.monitor.recording.reader import Recording, UnreadableError, read
from formation.monitor.report import figures
from formation.monitor.report.gather import Run, gather
from formation.monitor.report.page import ReportedRun, labels, page
from formation.monitor.report.parts import View
from formation.monitor.report.summary import as_json as numbers
from formation.monitor.report.summary import differences, notices, verdict
from formation.stability.analysis import analyse
from formation.transport.runtime.command_line import make_folder

READING_SHARE = 0.6
"""Share of reading in the work; the rest is drawing."""
GENERATOR = b'<meta name="generator" content="formation '
"""Text near the beginning of every page that is made."""
EXAMPLES = """\
  formation report recordings/monday.mcap                        monday.html beside it
  formation report monday.mcap --figures figures                 and every panel, for a paper
  formation report field.mcap paper.mcap -o laws.html            two runs, side by side

A recording that was cut off is read as far as it goes. One of several parts may be named by any of them.
Exit code 0: the page is made; 2: it could not be.
"""


def main(arguments: Sequence[str]) -> int:
    """Make a report; return the exit code."""
    options = _options().parse_args(arguments)
    if options.format and options.figures is None:
        raise Refusal("--format: needs --figures DIR")
    options.format = options.format or ["png", "svg"]
    recordings = [_open(path) for path in (options.file, options.second) if path is not None]
    out = _out(options.out, recordings)
    if options.figures is not None:
        with refuse_os_errors(f"--figures {options.figures}"):
            make_folder(options.figures)
    with Bar("report") as bar:
        runs = [
            _gather(
                recording,
                bar,
                (READING_SHARE * i / len(recordings), READING_SHARE * (i + 1) / len(recordings)),
            )
            for i, recording in enumerate(recordings)
        ]
        reported = [ReportedRun(run, check.words(run.mission, analyse(run.mission))) for run in runs]
        bar.at(READING_SHARE)
        made = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
        text = page(reported, options.until, made)
        with refuse_os_errors(f"--out {out}: cannot be written"):
            out.write_text(text, encoding="utf-8")
        bar.at(0.5 * (1.0 + READING_SHARE))
        drawn = _figures(options, runs) if options.figures is not None else []
    print_result(options, _words(runs, out, drawn, options.figures), lambda: _json(runs, out, drawn))
    return 0


def _open(path: Path) -> Recording:
    with refuse_errors(UnreadableError):
        return read(path)


def _gather(recording: Recording, bar: Bar, shares: tuple[float, float]) -> Run:
    """Read it all; the bar goes from the first to the second of `shares`. Raises Refusal."""

    def progress(_count: int, wall: float) -> None:
        done = (wall - begin) / duration
        bar.at(shares[0] + (shares[1] - shares[0]) * min(max(done, 0.0), 1.0))

    with refuse_os_errors(f"{recording.path}: cannot be read"):
        extent = recording.extent()
        begin, duration = extent.start or 0.0, extent.duration or 1.0
        return gather(recording, progress)


def _out(requested: Path | None, recordings: Sequence[Recording]) -> Path:
    """Return the page's path, in a folder that is made. Raises Refusal if it would destroy another file."""
    first = recordings[0].path
    stem = "-and-".join(recording.path.stem for recording in recordings)
    path: Path = requested or first.with_name(f"{stem}.html")
    mine = {part.resolve() for recording in recordings for part in (recording.path, *recording.parts)}
    with refuse_os_errors(f"--out {path}"):
        if path.exists() and path.resolve() in mine:
            raise Refusal(f"--out {path}: is the recording itself; name another file")
        check_file("--out", path, ".html")
        if path.exists() and not _is_report(path):
            raise Refusal(f"--out {path}: exists already, and is no report; name another file")
    return path


def _is_report(path: Path) -> bool:
    """Return whether the path has a page of ours, or nothing that could be lost."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        begin = file.read(1000)
    return not begin or GENERATOR in begin


def _figures(options: argparse.Namespace, runs: Sequence[Run]) -> list[Path]:
    """Write every figure as a file; two runs each get their own folder."""
    view = View.of(runs, options.until)
    folder: Path = options.figures
    try:
        if len(runs) == 1:
            return figures.write(folder, figures.of_run(runs[0], view), options.format)
        both = figures.overlay(dict(zip(labels(runs), runs, strict=True)), view)
        paths = figures.write(folder, {"overlay": both}, options.format)
        for letter, run in zip("ab", runs, strict=True):
            paths += figures.write(folder / letter, figures.of_run(run, view), options.format)
    except OSError as error:
        raise Refusal(f"--figures {folder}: {error.filename or folder}: {error.strerror}") from None
    return paths


def _words(runs: Sequence[Run], out: Path, drawn: Sequence[Path], folder: Path | None) -> str:
    lines = []
    for name, run in zip(labels(runs), runs, strict=True):
        lines.append(f"{name}: {verdict(run)}")
        lines += [f"  {notice}" for notice in notices(run)]
    if len(runs) == 2 and differences(runs[0].mission, runs[1].mission):
        lines.append("  These are different missions; the page says where they differ.")
    lines.append(f"  page             {out}")
    if folder is not None:
        lines.append(f"  figures          {len(drawn)} files in {folder}")
    return "\n".join(lines)


def _json(runs: Sequence[Run], out: Path, drawn: Sequence[Path]) -> dict[str, Any]:
    same = not differences(runs[0].mission, runs[-1].mission)
    return {
        "report": str(out),
        "figures": [str(path) for path in drawn],
        "same_mission": same,
        "runs": [numbers(run) for run in runs],
    }


def _formats(text: str) -> list[str]:
    chosen = [one.strip().lower() for one in text.split(",") if one.strip()]
    if not chosen or set(chosen) - set(figures.FORMATS):
        raise argparse.ArgumentTypeError(f"{text!r}: must be one or more of {', '.join(figures.FORMATS)}")
    return list(dict.fromkeys(chosen))


def _options() -> argparse.ArgumentParser:
    options = parser("report", "A recording as one page that loads nothing, and as figures.", EXAMPLES)
    options.add_argument("file", type=Path, metavar="FILE", help="a recording, MCAP")
    options.add_argument("second", type=Path, metavar="FILE2", nargs="?", help="one more, to compare with")
    add_out(options, "the page, .html (default: beside FILE, named after FILE and FILE2)", metavar="PAGE")
    options.add_argument(
        "--figures", type=Path, metavar="DIR", help="write every figure into this folder, too"
    )
    options.add_argument(
        "--format", type=_formats, metavar="F,...",
        help="formats of the figures: png, svg, pdf (default png,svg)",
    )  # fmt: skip
    options.add_argument(
        "--until", type=number(0.0, unit="s", open_below=True), metavar="S",
        help="last moment of the panels [s] (default: what it takes to see the formation form)",
    )  # fmt: skip
    add_json(options)
    return options
