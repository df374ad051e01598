"""The table of `formation run` and `formation watch`: one robot a line, and below it the formation."""

from __future__ import annotations

import math
import textwrap
import time
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from formation.deploy.terminal.snapshot import Progress, RobotNow, Snapshot
from formation.deploy.terminal.units import metres, seconds
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.snapshot import SATURATED_SHARE

BLOCKS = "▁▂▃▄▅▆▇█"
ASCII_BLOCKS = "_.-:=+*#"
LATE_POSITION_AGE = 0.5
"""Age from which on a position is marked [s]."""
COLOURS = {
    "run": "green", "hold": "yellow", "stop": "red", "waiting": "cyan", "dead": "bold red",
    "silent": "bold red", "unseen": "dim",
}  # fmt: skip
CANDIDATES = {"leads": "bold green", "standby": "dim", "lost": "bold red", "dead": "bold red"}
"""Styles of candidates' states."""
LEADER = "leader"
LEVELS = {20: "dim", 30: "yellow", 40: "bold red"}
"""Styles of events."""
MAX_EVENT_LINES = 8
"""Most lines for events, if there is room."""
COLUMNS = {
    "robot": 8, "state": 7, "error": 7, "u [m/s]": 12, "ω [rad/s]": 12, "θ error": 7, "age": 6,
}  # fmt: skip
"""Columns and their least width [characters], so that nothing jumps while figures change."""
LEFT_OUT_FIRST = ("θ error", "ω [rad/s]", "u [m/s]")
"""Columns that a narrow terminal does not show, the first to be left out first."""
NUMBERS = ("error", "θ error", "age")
"""Columns aligned to the right."""
ECHO_CHARS = len("^C")
"""Width left free after the last line [characters], where a terminal shows ^C at Ctrl-C. Without it that
would take one more line, and the table would be redrawn below its own title."""


def event_line(event: Event) -> str:
    """Return an event in one line, with its kind, as a text such as "under the bound" may not state it."""
    at = time.strftime("%H:%M:%S", time.localtime(event.at))
    about = " ".join(word for word in (event.robot, event.kind) if word)
    return f"{at}  {about}: {event.text}" if about else f"{at}  {event.text}"


def draw(progress: Progress, width: int, height: int, *, ascii_only: bool = False) -> RenderableType:
    """Return the table, at most `height` lines of `width` columns, with events below if there is room."""
    snapshot = progress.snapshot
    if snapshot is None:
        return Text(_beginning(progress))
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", pad_edge=False)
    room = width - _state_excess(snapshot)
    columns = _columns(room)
    for title in columns:
        side: Literal["left", "right"] = "right" if title in NUMBERS else "left"
        table.add_column(Text(title), justify=side, no_wrap=True, min_width=COLUMNS[title])
    footer = _footer(progress, snapshot, width, ascii_only=ascii_only)
    names, left_out = _shown_robots(progress, snapshot, max(1, height - 3 - len(footer)))
    title_room = room - _width(columns) + COLUMNS["robot"]
    for name in names:
        cells = _row(progress, snapshot, name, title_room, ascii_only=ascii_only)
        table.add_row(*(cells[title] for title in columns))
    heading = Text(f"{progress.mission.name}, {progress.mission.law.kind} law", style="bold")
    event_room = height - 3 - len(names) - bool(left_out) - len(footer)
    return Group(
        heading,
        table,
        *([Text(left_out, style="dim")] if left_out else []),
        *footer,
        *_events(progress, width, event_room),
    )


def _state_excess(snapshot: Snapshot) -> int:
    """Return by how much the longest state is wider than its column, as ``readonly: would run`` is."""
    longest = max((len(robot.state) for robot in snapshot.robots.values()), default=0)
    return max(0, longest - COLUMNS["state"])


def _width(columns: Sequence[str]) -> int:
    """Return the least width of columns with the spaces between them [characters]."""
    return sum(COLUMNS[title] for title in columns) + 2 * (len(columns) - 1)


def _columns(width: int) -> list[str]:
    """Return the columns for a terminal of `width` characters."""
    columns = list(COLUMNS)
    for title in LEFT_OUT_FIRST:
        if _width(columns) > width:
            columns.remove(title)
    return columns


def _beginning(progress: Progress) -> str:
    """Return the text before the first snapshot."""
    if progress.note:
        return f"{progress.mission.name}: {progress.note}"
    waits = "waiting for the monitor's first figures" if progress.phase == "running" else progress.phase
    return f"{progress.mission.name}: {waits}, {progress.ready} of {progress.processes} processes ready"


def _events(progress: Progress, width: int, room: int) -> list[Text]:
    """Return the newest events, wrapped, in at most `room` lines; of the newest the beginning at least."""
    lines: list[Text] = []
    for event in reversed(progress.events):
        left = min(room, MAX_EVENT_LINES) - len(lines)
        wrapped = textwrap.wrap(
            event_line(event), width - 1 - ECHO_CHARS, subsequent_indent="  ", break_on_hyphens=False
        )
        if left <= 0 or (lines and len(wrapped) > left):
            break
        style = LEVELS.get(event.level, "")
        lines = [*(Text(line, style=style) for line in wrapped[:left]), *lines]
    return lines


def _shown_robots(progress: Progress, snapshot: Snapshot, room: int) -> tuple[Sequence[str], str]:
    """Return the robots to show: all, or those with the largest errors, and a text about the others."""
    names = progress.mission.names
    if len(names) <= room:
        return names, ""

    def trouble(name: str) -> float:
        error = snapshot.robots[name].error if name in snapshot.robots else math.inf
        return math.inf if name in progress.dead_robots or error is None else error

    worst = set(sorted(names[1:], key=trouble, reverse=True)[: room - 1])
    return [n for n in names if n in worst], f"and {len(names) - len(worst)} more, with smaller errors"


def _row(
    progress: Progress, snapshot: Snapshot, name: str, room: int, *, ascii_only: bool
) -> dict[str, Text]:
    """Return the cells of a robot, by column; `room` is for its name [characters]."""
    robot = snapshot.robots.get(name, RobotNow())
    leads = name == progress.mission.leader
    called = LEADER if snapshot.leads in {None, name} else snapshot.leads  # another may lead by now
    state = "dead" if name in progress.dead_robots and not (leads and called != LEADER) else robot.state
    late = robot.age is not None and robot.age > LATE_POSITION_AGE
    limits = progress.mission.robots[name]
    title = f"{name} ({called})" if leads and name != LEADER else name
    error = metres(robot.error)
    if robot.error is None and robot.known_error is not None:  # over some neighbours: a lower bound
        least = metres(robot.known_error)
        error = f"{'>=' if ascii_only else '≥'}{'0 mm' if least.startswith('<') else least}"
    short = title if len(title) <= room else title[: max(room - 1, 1)] + ("." if ascii_only else "…")
    heading = "-" if robot.heading_error is None else f"{_signed(math.degrees(robot.heading_error), 1)}°"
    turn_limit = None if leads else limits.max_turn_rate
    return {
        "robot": Text(short),
        "state": _state(state, robot),
        "error": Text(error),
        "u [m/s]": _with_bar(robot.speed, None if leads else limits.max_speed, ascii_only=ascii_only),
        "ω [rad/s]": _with_bar(robot.turn_rate, turn_limit, ascii_only=ascii_only),
        "θ error": Text(heading),
        "age": Text(seconds(robot.age), style="yellow" if late else ""),
    }


def _state(state: str, robot: RobotNow) -> Text:
    """Return the robot's state; if it runs, also whether it follows, and obstacles."""
    if state == "run" and robot.stuck:
        return Text("stuck", style="yellow")
    if state == "run" and robot.unavailable:
        return Text("unavail", style="yellow")  # the word is wider than the column
    if state == "run" and robot.avoiding:
        return Text(robot.avoiding, style="yellow" if robot.avoiding == "blocked" else "cyan")
    return Text(state or "-", style=COLOURS.get(state, ""))


def _with_bar(value: float | None, limit: float | None, *, ascii_only: bool) -> Text:
    """Return a command, a bar for its share of the limit, and a mark if it is at the limit."""
    if value is None:
        return Text("-")
    text = Text(f"{_signed(value, 2):>6} ")
    if limit is not None:
        share = abs(value) / limit
        full = min(4, round(share * 4))
        bar, rest = ("#", ".") if ascii_only else ("━", "╌")
        at_limit = share >= SATURATED_SHARE
        text.append(bar * full, style="red" if at_limit else "green")
        text.append(rest * (4 - full), style="dim")
        text.append("!" if at_limit else " ", style="bold red")
    return text


def _signed(value: float, digits: int) -> str:
    """Return the number, without a minus sign if it is rounded to zero."""
    return f"{round(value, digits) + 0.0:.{digits}f}"


def _footer(progress: Progress, snapshot: Snapshot, width: int, *, ascii_only: bool) -> list[Text]:
    head = f"error {metres(snapshot.known_error):>8} "
    mark = f" settled (< {metres(progress.mission.settled)})" if progress.settled else ""
    room = max(8, width - len(head) - len(mark) - 1)
    first = Text(head)
    first.append(sparkline(progress.errors, room, ASCII_BLOCKS if ascii_only else BLOCKS), style="cyan")
    first.append(mark, style="bold green")

    lines = [first]
    if snapshot.partial is not None:
        lines.append(Text(f"over {snapshot.partial.words}", style="yellow"))
    lines += _leading(progress, snapshot, ascii_only=ascii_only)
    if progress.duration is not None or progress.phase == "running":
        lines.append(_clock(progress, width, ascii_only=ascii_only))
    lines += [Text(f"{name} {how}", style="bold red") for name, how in progress.dead.items()]
    return lines


def _leading(progress: Progress, snapshot: Snapshot, *, ascii_only: bool) -> list[Text]:
    """Return the leader, candidates, awaited robots, the shape if not as drawn, and fallbacks in use."""
    lines: list[Text] = []
    if snapshot.candidates:
        text = Text()
        for name, state in snapshot.candidates.items():
            word = "lost" if state == "silent" else state or "-"
            word = "dead" if name in progress.dead_robots and word != "leads" else word
            text.append(f"{'' if not text else '  '}{name} ")
            text.append(word, style=CANDIDATES.get(word, "yellow"))
        lines.append(text)
    if snapshot.waits:
        lines.append(Text(f"the leader waits for {snapshot.waits}", style="yellow"))
    if snapshot.placed_shape:
        shape = snapshot.placed_shape.replace("°", " deg") if ascii_only else snapshot.placed_shape
        lines.append(Text(shape, style="cyan"))
    others = [f"{name} follows {one.fallback}" for name, one in snapshot.robots.items() if one.fallback]
    if others:
        lines.append(Text(f"in place of lost neighbours: {'; '.join(others)}", style="yellow"))
    return lines


def _clock(progress: Progress, width: int, *, ascii_only: bool) -> Text:
    if progress.duration is None:
        return Text(f"watched for {progress.elapsed:.0f} s, Ctrl-C ends it", style="dim")
    clock = f"{progress.elapsed:.0f} of {progress.duration:g} s "
    if progress.phase != "running":
        clock += f"({progress.phase}) "
    room = max(8, width - len(clock) - 1 - ECHO_CHARS)
    done = min(room, round(room * progress.elapsed / progress.duration))
    text = Text(clock)
    text.append(("#" if ascii_only else "━") * done, style="green")
    text.append(("." if ascii_only else "╌") * (room - done), style="dim")
    return text


def sparkline(values: Sequence[float], width: int, blocks: str = BLOCKS) -> str:
    """Return all of `values` in at most `width` characters, each the mean of its span, on a log scale."""
    positive = [max(value, 1e-6) for value in values]
    if not positive:
        return ""
    count = min(width, len(positive))
    cuts = [round(i * len(positive) / count) for i in range(count + 1)]
    logs = [math.log(math.fsum(positive[a:b]) / (b - a)) for a, b in pairwise(cuts)]
    low, high = min(logs), max(logs)
    span = max(high - low, math.log(10.0))  # noise around one value must look flat
    return "".join(blocks[min(len(blocks) - 1, int((value - low) / span * len(blocks)))] for value in logs)
