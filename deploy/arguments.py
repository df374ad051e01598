"""Shared by the subcommands: read arguments, refuse them, and print or write the result."""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from formation.control.laws import LAWS, why_unusable
from formation.deploy.refusal import Refusal, refuse_errors, refuse_os_errors
from formation.mission.file import MISSION_HELP, MissionError, load
from formation.mission.model import Mission
from formation.transport.runtime.command_line import Parser, make_folder
from formation.transport.runtime.flags import add_zenoh


def parser(command: str, summary: str, examples: str) -> argparse.ArgumentParser:
    """Return a parser for `formation COMMAND`."""
    return Parser(f"formation {command}", summary, examples)


def add_mission(to: argparse.ArgumentParser, default: str | None = None, *, law: bool = True) -> None:
    """Add the MISSION argument, and with `law` --law, which overrides the mission's."""
    to.add_argument(
        "mission",
        metavar="MISSION",
        nargs=None if default is None else "?",
        default=default,
        help=MISSION_HELP + (f" (default {default})" if default else ""),
    )
    if law:
        add_law(to, "instead of the mission's")


def add_law(to: argparse.ArgumentParser, instead: str) -> None:
    """Add --law, with words about what it replaces."""
    to.add_argument("--law", type=_law, metavar=f"{{{','.join(LAWS)}}}", help=f"the control law, {instead}")


def _law(text: str) -> str:
    if (why := why_unusable(text)) is not None:
        raise argparse.ArgumentTypeError(why)
    return text


def add_dask(to: argparse.ArgumentParser) -> None:
    """Add --dask."""
    to.add_argument(
        "--dask", metavar="ADDRESS", type=_scheduler,
        help="compute on the Dask cluster with this scheduler, such as tcp://192.168.1.5:8786; the result is"
        " the same; needs the extra dask, on its workers too",
    )  # fmt: skip


def _scheduler(text: str) -> str:
    if not re.fullmatch(r"([a-z]+://)?[^/]+:\d+", text):
        raise argparse.ArgumentTypeError(f"{text!r}: must be HOST:PORT, such as tcp://192.168.1.5:8786")
    return text


def add_json(to: argparse.ArgumentParser) -> None:
    """Add the --json flag: stdout is then JSON alone, and words for people go to stderr."""
    to.add_argument("--json", action="store_true", help="one JSON object on stdout, and nothing else there")


def add_links(to: argparse.ArgumentParser) -> None:
    """Add the flags for linking with a fleet that runs."""
    links = to.add_argument_group("links (without -e and endpoints in FILE those that the mission implies)")
    add_zenoh(links, connect="endpoint of an agent or the leader to dial; repeatable")


def read_mission(name: str, law: str | None = None) -> Mission:
    """Return the mission, with `law` if given. Raises Refusal."""
    with refuse_errors(MissionError):
        mission = load(name)
    return mission if law is None else mission.under(law)


def read_driven(name: str, law: str | None = None) -> Mission:
    """Return the mission, with `law` if given, for what drives or simulates robots. Raises Refusal.

    Commands that stop robots, or only show them, do without the law's file.
    """
    mission = read_mission(name, law)
    if (why := why_unusable(mission.law.kind)) is not None:
        raise Refusal(f"{name}: {why}")
    return mission


def number(
    lowest: float, highest: float = math.inf, unit: str = "", *, open_below: bool = False
) -> Callable[[str], float]:
    """Return an argument type: a finite number of `unit` from `lowest` (or above it) to `highest`."""
    below, unit = "above" if open_below else "at least", unit and f" {unit}"
    legal = f"{below} {lowest:g}{unit} and finite"
    if math.isfinite(highest):
        legal = f"{below} {lowest:g} and at most {highest:g}{unit}"

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise _illegal(repr(text.strip()), f"a number without a unit, {legal}") from None
        low = value > lowest if open_below else value >= lowest
        if not (math.isfinite(value) and low and value <= highest):
            raise _illegal(text.strip(), legal)
        return value

    return read


def whole(lowest: int, highest: int | None = None) -> Callable[[str], int]:
    """Return an argument type: a whole number from `lowest` to `highest`."""
    legal = f"at least {lowest}" + ("" if highest is None else f" and at most {highest}")

    def read(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise _illegal(repr(text.strip()), f"a whole number, {legal}") from None
        if value < lowest or (highest is not None and value > highest):
            raise _illegal(text.strip(), legal)
        return value

    return read


def _illegal(text: str, legal: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"{text}: must be {legal}")


def add_out(to: argparse.ArgumentParser, what: str, *, metavar: str = "FILE", required: bool = False) -> None:
    """Add the -o, --out flag of every command that writes."""
    to.add_argument("-o", "--out", type=Path, metavar=metavar, required=required, help=what)


def check_file(flag: str, path: Path, *suffixes: str) -> None:
    """Make the folder of a file to write; raise Refusal for a path that cannot be one of these suffixes."""
    with refuse_os_errors(f"{flag} {path}"):
        if path.is_dir():
            raise Refusal(f"{flag} {path}: is a folder; name a file")
        if path.suffix.lower() not in suffixes:
            legal = " or ".join(filter(None, [", ".join(suffixes[:-1]), suffixes[-1]]))
            raise Refusal(f"{flag} {path}: must end in {legal}")
        make_folder(path.parent)


def text_stream(options: argparse.Namespace) -> TextIO:
    """Return the stream for people: with --json stdout is for a script."""
    return sys.stderr if options.json else sys.stdout


def print_result(options: argparse.Namespace, words: str, result: Callable[[], Mapping[str, Any]]) -> None:
    """Print a command's result as its flags request: `words` for people, `result` for a script."""
    print(words, file=text_stream(options), flush=True)
    if options.json:
        print(as_json(result()), flush=True)


def as_json(result: Mapping[str, Any]) -> str:
    """Return one line of strict JSON: non-finite numbers become null."""
    return json.dumps(_finite(result), allow_nan=False, ensure_ascii=False)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a new file beside `path` that only this user can read, and which replaces it if all goes well."""
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    os.close(handle)
    new = Path(name)
    try:
        yield new
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
