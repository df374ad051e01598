"""`formation recover`: repair a recording that a power cut, a kill or a full disk cut off or damaged."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from formation.deploy.arguments import add_json, add_out, as_json, parser
from formation.deploy.refusal import Refusal, refuse_errors
from formation.deploy.terminal.bar import Bar
from formation.monitor.recording.reader import UnreadableError
from formation.monitor.recording.recover import Found, recover

EXAMPLES = """\
  formation recover recordings/six-robots-20260801-101500.mcap
  formation recover monday.mcap -o monday-whole.mcap

`formation report` and `formation replay` read what is readable of such a recording; Foxglove, PlotJuggler and
`ros2 bag` need a complete one. Exit code 0: FILE is complete, or a complete copy was written; 2: nothing was
written.
"""


def main(arguments: Sequence[str]) -> int:
    """Recover one file; return the exit code."""
    args = _flags().parse_args(arguments)
    out = args.out or args.file.parent / f"{args.file.stem}-recovered{args.file.suffix}"
    try:
        with refuse_errors(UnreadableError), Bar(f"recovering {args.file}") as bar:
            found = recover(
                args.file,
                out,
                checked=lambda share: bar.at(0.5 * share),
                copied=lambda share: bar.at(0.5 + 0.5 * share),
            )
    except FileExistsError:
        reason = "exists already; name a new file"
        raise Refusal(f"--out {out}: {reason if out.exists() else f'{out.parent} is no folder'}") from None
    except OSError as error:
        raise Refusal(f"{args.file}: cannot be recovered to {out}: {error.strerror}") from None
    print(as_json(_report(args.file, out, found)) if args.json else _words(args.file, out, found))
    return 0


def _report(file: Path, out: Path, found: Found) -> dict[str, Any]:
    return {
        "file": str(file),
        "whole": found.is_whole,
        "recovered": None if found.is_whole else str(out),
        "messages": found.extent.counts.total(),
        "start": found.extent.start,
        "end": found.extent.end,
        "unreadable_bytes": found.unreadable,
        "damaged_stretches": found.condition.damaged,
    }


def _words(file: Path, out: Path, found: Found) -> str:
    extent = found.extent
    span = ""
    if extent.start is not None and extent.end is not None:
        span = f" from {_time(extent.start)} to {_time(extent.end)} ({extent.duration:.1f} s)"
    what = f"{extent.counts.total()} messages{span}"
    if found.is_whole:
        return f"{file} is whole: {what}. Nothing was written."
    lines = [f"{file} is {found.condition.words}. {what} are in {out}."]
    if found.unreadable:
        lines.append(f"lost: its last {found.unreadable} bytes, which were not written to their end")
    if found.condition.damaged:
        lines.append("lost: the messages in each damaged place, as a rule half a second's")
    if found.condition.is_cut:
        lines.append("lost: what was received after that, within a second of the end")
    return "\n".join(lines)


def _time(seconds: float) -> str:
    return f"{datetime.fromtimestamp(seconds).astimezone():%Y-%m-%d %H:%M:%S.%f}"[:-3]


def _flags() -> argparse.ArgumentParser:
    flags = parser(
        "recover",
        "Make a recording whole that was cut off or damaged. The original is never touched.",
        EXAMPLES,
    )
    flags.add_argument("file", metavar="FILE", type=Path, help="the recording: an MCAP file of `formation`'s")
    add_out(flags, "where to (default: FILE with -recovered in its name)", metavar="WHOLE")
    add_json(flags)
    return flags
