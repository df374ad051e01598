"""Display of a run: in a terminal of 80 by 24, without colour, and without a terminal."""

from __future__ import annotations

import io
import itertools
import math
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import replace
from typing import Any

import pytest
from rich.console import Console

from formation.deploy.terminal.snapshot import Progress, RobotNow, Snapshot
from formation.deploy.terminal.table import ASCII_BLOCKS, BLOCKS, draw, event_line, sparkline
from formation.deploy.terminal.units import metres, seconds
from formation.deploy.terminal.views import LiveTable, PlainLines, line
from formation.mission.file import load
from formation.monitor.metrics.event import Event
from formation.monitor.metrics.metrics import Metrics
from formation.monitor.metrics.words import as_json
from tests.support import monitored
from tests.support.monitored import with_standbys
from tests.unit.monitor.metrics.test_leading import Team

SILENT = as_json(Metrics(load("six_robots")).snapshot(monitored.now(10.0)))
SILENT["known"] |= {"error": 0.012, "known_edges": 7, "edges": 9, "silent": {"robot6": 12.4}}
SILENT["robots"]["robot5"]["known"] = [0.003, 1, 2]
RUNNING = RobotNow("run", 0.12, 0.75, -0.4, math.radians(-3.0), 0.031)


def progress(mission: str = "six_robots", robots: Mapping[str, RobotNow] | None = None) -> Progress:
    """A run of `mission` after 12 s, with every robot running, or as `robots` has it."""
    now = Progress(load(mission), 30.0, 8, phase="running", ready=8, elapsed=12.0)
    now.add_snapshot(Snapshot(1.25, {**dict.fromkeys(now.mission.names, RUNNING), **(robots or {})}))
    return now


def picture(now: Progress, width: int = 80, height: int = 24, *, ascii_only: bool = False) -> list[str]:
    console = Console(width=width, height=height, file=io.StringIO(), color_system=None, force_terminal=True)
    console.print(draw(now, width, height, ascii_only=ascii_only))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def row(lines: list[str], robot: str) -> str:
    return next(text for text in lines if text.startswith(robot))


@pytest.mark.parametrize("mission", ["six_robots", "turtlebot3_pair", "two_chains", "posts"])
def test_table_of_shipped_mission_fits_80_by_24(mission: str) -> None:
    now = progress(mission)
    lines = picture(now)
    assert len(lines) <= 23  # the cursor stands in the last one
    assert all(len(text) <= 80 for text in lines)
    assert all("…" not in text for text in lines)
    assert all(row(lines, name) for name in now.mission.names)


def test_columns_have_titles_and_units() -> None:
    assert " ".join(row(picture(progress()), "robot ").split()) == (
        "robot state error u [m/s] ω [rad/s] θ error age"
    )


@pytest.mark.parametrize(
    ("robot", "shown"),
    [
        (RUNNING, "run 12 cm 0.75 ━━╌╌ -0.40 ━╌╌╌ -3.0° 31 ms"),
        (RUNNING._replace(speed=-1.5), "run 12 cm -1.50 ━━━━! -0.40 ━╌╌╌ -3.0° 31 ms"),
        (
            RUNNING._replace(speed=-0.001, turn_rate=-0.0, heading_error=-1e-5),
            "run 12 cm 0.00 ╌╌╌╌ 0.00 ╌╌╌╌ 0.0° 31 ms",
        ),
        (RUNNING._replace(avoiding="avoids"), "avoids 12 cm 0.75 ━━╌╌ -0.40 ━╌╌╌ -3.0° 31 ms"),
        (RobotNow(), "- - - - - -"),
        (RobotNow("silent", age=4.0), "silent - - - - 4 s"),
    ],
)
def test_row_shows_state_error_commands_heading_and_age(robot: RobotNow, shown: str) -> None:
    assert row(picture(progress(robots={"robot3": robot})), "robot3").split() == ["robot3", *shown.split()]


def test_long_name_is_cut_and_figures_stay_complete() -> None:
    now = progress("turtlebot3_pair")
    robots = {"robot" * 10: now.mission.robots["robot1"], "leader": now.mission.robots["leader"]}
    now.mission = now.mission.model_construct(**{**dict(now.mission), "robots": robots})
    now.add_snapshot(Snapshot(1.0, dict.fromkeys(robots, RUNNING)))
    text = row(picture(now), "robotro")
    assert len(text) <= 80
    assert text.endswith("31 ms")
    assert "robotrobotrobotr…" in text


@pytest.mark.parametrize(
    ("width", "shown"),
    [
        (71, "run 12 cm 0.75 ━━╌╌ -0.40 ━╌╌╌ -3.0° 31 ms"),
        (64, "run 12 cm 0.75 ━━╌╌ -0.40 ━╌╌╌ 31 ms"),
        (50, "run 12 cm 0.75 ━━╌╌ 31 ms"),
        (40, "run 12 cm 31 ms"),
    ],
)
def test_narrow_table_leaves_out_whole_columns(width: int, shown: str) -> None:
    lines = picture(progress(), width)
    assert row(lines, "robot3").split() == ["robot3", *shown.split()]
    assert all(len(text) <= width for text in lines)


@pytest.mark.parametrize("width", [80, 60])
def test_long_state_leaves_out_columns_not_units(width: int) -> None:
    robots = {"robot3": RUNNING._replace(state="readonly: would run"), "robot4": RUNNING}
    lines = picture(progress(robots=robots), width)
    assert all(row(lines, name).endswith("31 ms") for name in robots)
    assert all(len(text) <= width for text in lines)


def test_robot_with_dead_agent_is_shown_as_dead() -> None:
    now = progress()
    now.dead["agent robot4"] = "was killed (Killed) during the run"
    now.dead_robots.add("robot4")
    lines = picture(now)
    assert row(lines, "robot4").split()[1] == "dead"
    assert "agent robot4 was killed (Killed) during the run" in lines


def test_footer_shows_total_error_time_and_settled() -> None:
    now = progress()
    lines = picture(now)
    assert row(lines, "error").startswith("error   1.25 m")
    assert row(lines, "12 of 30 s").count("━") == pytest.approx(row(lines, "12 of").count("╌") / 1.5, abs=1)
    assert "settled" not in "".join(lines)
    now.add_snapshot(Snapshot(0.0004, dict.fromkeys(now.mission.names, RUNNING)))
    assert "settled" in row(picture(now), "error")


@pytest.mark.parametrize(("width", "elapsed"), [(80, 3.0), (80, 12.0), (120, 29.9)])
def test_last_line_leaves_room_for_ctrl_c(width: int, elapsed: float) -> None:
    now = progress()
    now.elapsed = elapsed
    for phase in ("running", "stopping"):
        now.phase = phase
        assert (
            len(picture(now, width)[-1] + "^C") < width
        )  # else the line wraps, and the cursor is lower than assumed


def test_short_table_shows_robots_in_trouble_first() -> None:
    now = progress("two_chains", {"right3": RUNNING._replace(error=0.9), "left6": RobotNow("unseen")})
    lines = picture(now, height=10)
    assert len(lines) <= 9
    assert row(lines, "right3")
    assert row(lines, "left6")
    assert any(text.startswith("and ") and "more" in text for text in lines)


def test_dead_monitor_clears_old_figures() -> None:
    now = progress()
    now.add_snapshot(now.snapshot._replace(error=0.001) if now.snapshot else Snapshot(0.001, {}))
    now.dead["monitor"] = "was killed (SIGKILL)"
    now.forget_snapshot()
    assert not now.settled
    assert line(now) == " 12.0 of 30 s  nothing is known: the monitor has ended"
    lines = picture(now)
    assert row(lines, "robot3").split() == ["robot3", "-", "-", "-", "-", "-", "-"]
    assert row(lines, "error").split()[1] == "-"
    assert "settled" not in "\n".join(lines)
    assert "monitor was killed (SIGKILL)" in lines


def test_display_before_first_snapshot_counts_ready_processes() -> None:
    now = Progress(load("six_robots"), 30.0, 8, ready=3)
    assert picture(now) == ["six-robots: starting, 3 of 8 processes ready"]


def test_ascii_only_table_has_no_unicode_blocks() -> None:
    assert not set("".join(picture(progress(), ascii_only=True))) & set(BLOCKS + "━╌")


LOST = Event(1_700_000_000.0, 40, "robot4", "lost", "silent for 1.0 s; last state: run")
SETTLED = Event(1_700_000_001.0, 20, "", "settled", "under the bound of 50 mm since 3.6 s")


def test_events_are_listed_below_table_newest_last() -> None:
    now = progress()
    before = picture(now)
    now.events += [LOST, SETTLED]
    lines = picture(now)
    assert lines[: len(before)] == before
    assert lines[len(before) :] == [event_line(LOST), event_line(SETTLED)]
    assert event_line(LOST)[8:] == "  robot4 lost: silent for 1.0 s; last state: run"
    assert event_line(SETTLED)[8:] == "  settled: under the bound of 50 mm since 3.6 s"


@pytest.mark.parametrize("height", [8, 10, 11, 12, 24])
@pytest.mark.parametrize("width", [60, 80])
def test_events_use_at_most_the_remaining_lines(height: int, width: int) -> None:
    now = progress()
    now.events += [LOST._replace(text=f"{number} silent") for number in range(60)]
    lines = picture(now, width, height)
    assert len(lines) <= height - 1
    assert len(lines[-1] + "^C") < max(width, 80)
    reported = [text for text in lines if "robot4 lost: " in text]
    assert len(reported) == max(0, min(height - 1 - 10, 8))
    assert all("robot4 lost: 59 " in text for text in reported[-1:])


@pytest.mark.parametrize("height", [12, 16, 24])
@pytest.mark.parametrize("width", [40, 60, 80])
def test_long_event_is_wrapped_within_the_remaining_lines(height: int, width: int) -> None:
    now = progress()
    before = len(picture(now, width, height))
    now.events += [LOST._replace(text=f"{number} " + "long " * 20 + "end") for number in range(9)]
    lines = picture(now, width, height)
    assert len(lines) <= height - 1
    assert all(len(text + "^C") < width for text in lines[before:])
    shown = " ".join(text.strip() for text in lines[before:])
    assert "robot4 lost: 8 long" in shown
    assert shown.endswith("end") or height < 16


def test_snapshot_adds_its_events_to_progress() -> None:
    now = progress()
    now.add_snapshot(Snapshot.of({**SILENT, "events": [LOST._asdict(), SETTLED._asdict()]}))
    assert list(now.events) == [LOST, SETTLED]


def test_watch_without_duration_shows_only_elapsed_time() -> None:
    now = progress()
    now.duration = None
    assert picture(now)[-1] == "watched for 12 s, Ctrl-C ends it"
    assert line(now).startswith(" 12.0 s  error 1.25 m")
    now.phase = "over"
    assert picture(now)[-1].startswith("error")


def test_unanswered_connection_shows_message_instead_of_table() -> None:
    now = Progress(load("six_robots"), phase="running", note="no process answers at tcp/x\n  try this")
    assert picture(now) == ["six-robots: no process answers at tcp/x", "  try this"]
    assert line(now) == "  0.0 s  no process answers at tcp/x"


def test_plain_lines_print_each_event_and_note_once() -> None:
    stream = io.StringIO()
    view, now = PlainLines(stream), Progress(load("six_robots"), phase="running", note="looking")
    view.show(now)
    view.show(now)
    now.note = "no process answers"
    view.show(now)
    for events in ((LOST,), (SETTLED, LOST._replace())):
        now.add_snapshot(Snapshot(1.0, {}, events))
        view.show(now)
    view.show(now)
    assert stream.getvalue().splitlines() == [
        "six-robots: looking", "six-robots: no process answers",
        event_line(LOST), event_line(SETTLED), event_line(LOST),
    ]  # fmt: skip


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def test_live_table_is_redrawn_in_place_and_remains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    terminal, now = Terminal(), progress()
    with LiveTable(terminal) as view:
        view.show(now)
        assert "robot3" in terminal.getvalue()
        assert "\x1b[1A" not in terminal.getvalue()
        now.elapsed = 13.0
        view.show(now)
        assert "\x1b[1A" in terminal.getvalue()  # moves up, to overwrite the old table
    assert "13 of 30 s" in terminal.getvalue()


def test_plain_lines_come_every_two_seconds_and_at_process_end(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count(1000)
    monkeypatch.setattr("formation.deploy.terminal.views.time.monotonic", lambda: 0.1 * next(ticks))
    stream = io.StringIO()
    view, now = PlainLines(stream), progress()
    for _ in range(50):
        view.show(now)
    assert len(stream.getvalue().splitlines()) == 2
    now.dead["monitor"] = "ended with exit code 1 during the run"
    view.show(now)
    view.show(now)
    assert stream.getvalue().splitlines()[2:] == ["monitor ended with exit code 1 during the run"]


def test_plain_line_counts_robots_by_state() -> None:
    assert line(progress(robots={"robot2": RUNNING._replace(state="hold")})) == (
        " 12.0 of 30 s  error 1.25 m  5 run, 1 hold"
    )
    assert "nothing received from the monitor" in line(replace(progress(), snapshot=None))


def test_sparkline_is_logarithmic_and_within_its_width() -> None:
    assert sparkline([10.0 ** -(k / 7) for k in range(8)], 80) == BLOCKS[::-1]
    assert len(sparkline([1.0] * 1000, 20)) == 20
    assert sparkline([], 20) == ""
    assert set(sparkline([0.0, 1e-9, 5.0], 3, ASCII_BLOCKS)) <= set(ASCII_BLOCKS)


def test_sparkline_of_small_noise_is_flat() -> None:
    assert len(set(sparkline([1.0, 1.01, 0.99, 1.02], 4))) == 1


@pytest.mark.parametrize(
    ("length", "text"),
    [
        (None, "-"), (math.nan, "-"), (0.0, "0 mm"), (2e-5, "<0.1 mm"), (0.0008, "0.8 mm"),
        (0.00994, "9.9 mm"), (0.00996, "10 mm"), (0.0994, "99 mm"), (0.0996, "10 cm"), (0.994, "99 cm"),
        (0.996, "1.00 m"), (12.345, "12.35 m"),
    ],
)  # fmt: skip
def test_metres_chooses_unit_after_rounding(length: float | None, text: str) -> None:
    assert metres(length) == text


@pytest.mark.parametrize(
    ("time", "text"), [(None, "-"), (math.inf, "-"), (0.031, "31 ms"), (0.9996, "1 s"), (12.3, "12 s")]
)
def test_seconds_gives_short_text(time: float | None, text: str) -> None:
    assert seconds(time) == text


def test_partial_error_shows_known_and_unknown_edges() -> None:
    now = progress()
    now.add_snapshot(Snapshot.of(SILENT))
    text = picture(now)
    assert any(line.startswith("error    12 mm ") for line in text)
    assert "over 7 of 9 edges; 2 unknown (robot6 silent for 12 s)" in text
    assert "≥3.0 mm" in row(text, "robot5")
    assert ">=3.0 mm" in row(picture(now, ascii_only=True), "robot5")
    assert "error 12 mm over 7 of 9 edges; 2 unknown (robot6 silent for 12 s)  settled" in line(now)
    assert now.errors[-1] == 0.012


def test_tiny_lower_bound_of_partial_error_is_zero() -> None:
    now, silent = progress(), deepcopy(SILENT)
    silent["robots"]["robot5"]["known"] = [1e-5, 1, 2]
    now.add_snapshot(Snapshot.of(silent))
    assert "  ≥0 mm  " in row(picture(now), "robot5")


def drawn(event: dict[str, Any], *, dead: str = "", ascii_only: bool = False) -> list[str]:
    now = Progress(with_standbys(), phase="running", dead_robots={dead} - {""})
    now.add_snapshot(Snapshot.of(event))
    return picture(now, 90, 30, ascii_only=ascii_only)


def failed_over() -> dict[str, Any]:
    """Snapshot of the monitor after spare1 has taken over from robot1."""
    team = Team(12.0)
    team.fail_over()
    return as_json(team.seen)


def test_dead_leader_process_is_shown_beside_new_leader() -> None:
    assert "robot1 lost  spare1 leads  spare2 standby" in "\n".join(drawn(failed_over()))
    lines = drawn(failed_over(), dead="robot1")
    assert row(lines, "robot1 (spare1)").split()[2] == "run"
    assert "robot1 dead  spare1 leads" in "\n".join(lines)


def test_only_unusual_conditions_have_a_line() -> None:
    event = failed_over()
    plain = "\n".join(drawn(event))
    assert not [word for word in ("waits", "turned", "in place of") if word in plain]
    event |= {"waits": "robot4", "rotation": 0.5, "scale": 1.5, "formed": False}
    event["robots"]["robot4"] |= {"unavailable": True, "state": "run"}
    event["robots"]["robot6"] |= {"fallback": "robot3"}
    lines = drawn(event)
    text = "\n".join(lines)
    assert "the leader waits for robot4" in text
    assert "hexagon turned by 28.6°, 1.5 times as large, on its way" in text
    assert "in place of lost neighbours: robot6 follows robot3" in text
    assert row(lines, "robot4").split()[1] == "unavail"
    assert "°" not in drawn(event, ascii_only=True)[-4]
