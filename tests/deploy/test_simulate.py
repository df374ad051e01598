"""`formation simulate`: what it passes on, refuses and prints. The loop itself is tested where it lives."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from deploy import simulate
from deploy.cli import main
from deploy.terminal.bar import Bar
from formation.mission_file import parse, read
from formation.simulation.body import PROFILES

SHORT = ("--horizon", "15")


def simulated(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[str, dict[str, Any]]:
    assert main(["simulate", "turtlebot3_pair", *SHORT, *arguments, "--json"]) == 0
    out = capsys.readouterr().out
    return out, json.loads(out.splitlines()[-1])


def test_the_json_has_every_figure(capsys: pytest.CaptureFixture[str]) -> None:
    _, result = simulated(capsys, "--runs", "20", "--spread", "0.2", "--seed", "3")
    assert result["mission"] == "turtlebot3-pair"
    assert (result["runs"], result["seed"], result["law"]) == (20, 3, "field")
    assert result["converged_fraction"] == 1.0
    assert 0.0 < result["settling_time"]["median"] <= result["settling_time"]["p95"] < 15.0
    assert 0.0 <= result["final_error"]["median"] <= result["final_error"]["max"] < 0.05
    assert result["wall_time"] > 0.0
    assert result["robot_steps_per_second"] > 0.0


def test_it_says_that_it_simulates_no_scanners_and_nothing_that_stands_about(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["simulate", "posts", "--json"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert "  not simulated    scanners, posts, walls, ramp; formation run has them" in lines
    assert json.loads(last)["not_simulated"] == ["scanners", "posts", "walls", "ramp"]
    text, result = simulated(capsys, "--law", "paper")
    assert "not simulated" not in text
    assert result["not_simulated"] == []


ENDLESS = "speed = 0.05\nheading_deg = 0\n"
CORNER = f"{ENDLESS}duration = 5\n[[route]]\nspeed = 0.05\nheading_deg = 90\n"
ROUND = "speed = 0.05\nradius = 4\n"
NO_RAMP = ("[robot]", "[robot]\nramp = 0")
TURNING = ("duration", "turning = true\nduration")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ((), ["ramp"]),
        ((NO_RAMP,), []),
        ((NO_RAMP, ("[collisions]", "[together]\nerror = 0.5\n[collisions]")), ["together"]),
        ((NO_RAMP, TURNING), []),
        ((NO_RAMP, (ENDLESS, CORNER)), []),
        ((NO_RAMP, (ENDLESS, CORNER), TURNING), ["turning"]),
        ((NO_RAMP, (ENDLESS, ROUND), TURNING), ["turning"]),
    ],
)
def test_what_the_mission_has_and_this_does_not_is_named(
    changes: tuple[tuple[str, str], ...], named: list[str]
) -> None:
    text = read("turtlebot3_pair")[0]
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    assert simulate.left_out(parse(text, "mission.toml")) == named


def test_where_collisions_are_off_it_says_that_nobody_looked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = read("turtlebot3_pair")[0].replace("[collisions]", '[collisions]\nmode = "off"')
    (tmp_path / "off.toml").write_text(text)
    assert main(["simulate", str(tmp_path / "off.toml"), *SHORT, "--json"]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert "  bodies           not watched: collisions are off" in lines
    assert json.loads(last)["touched"] is None


def test_one_run_starts_as_the_mission_says_and_many_as_the_seed_says(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text, first = simulated(capsys)
    assert "the mission's own starts" in text
    assert simulated(capsys, "--seed", "9")[1]["settling_time"] == first["settling_time"]
    text, many = simulated(capsys, "--runs", "5", "--seed", "1")
    assert "5 random starts, seed 1" in text
    assert simulated(capsys, "--runs", "5", "--seed", "1")[1]["final_error"] == many["final_error"]
    assert simulated(capsys, "--runs", "5", "--seed", "2")[1]["final_error"] != many["final_error"]


def test_one_run_from_a_random_start_does_not_claim_to_be_the_missions(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text, _ = simulated(capsys, "--spread", "0.2", "--seed", "4")
    assert "1 random start, seed 4" in text
    assert "the mission's own" not in text


def test_it_says_whether_bodies_touched_and_whether_anybody_avoided_that(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text, result = simulated(capsys, "--runs", "20", "--seed", "1", "--law", "paper")
    assert f"bodies           touch in {result['touched']} of 20 runs" in text
    assert "; nobody avoids anybody" in text  # the printed law is said as it is
    assert (result["touched"] > 0) == (result["nearest"] < 0.0)
    assert main(["simulate", "six_robots", *SHORT]) == 0
    text = capsys.readouterr().out
    assert "bodies           none touch, " in text
    assert "nobody avoids" not in text


def test_runs_that_do_not_fit_into_memory_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(simulate, "simulate", full)
    assert main(["simulate", "six_robots", "--runs", "5000"]) == 2
    assert capsys.readouterr().err == "formation: --runs 5000: more than fits into memory; take fewer\n"


def test_a_worse_world_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, Any] = {}

    def stop(*_: object, **arguments: Any) -> None:
        seen.update(arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "simulate", stop)
    flags = ["--delay", "0.1", "--loss", "0.2", "--noise", "0.003", "--quantised", "--law", "paper"]
    assert main(["simulate", "six_robots", *flags]) == 130
    options = seen["options"]
    assert (options.delay, options.loss) == (0.1, 0.2)
    assert options.body.position_noise == 0.003
    assert options.body.speed_step == PROFILES["turtlebot3_burger"].speed_step > 0.0
    assert seen["starts"] is None


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--runs", "0"], "at least 1"),
        (["--runs", "1000000000"], "at most 100000"),
        (["--runs", "1.5"], "invalid whole number value: '1.5'"),
        (["--delay", "-1"], "at least 0"),
        (["--loss", "1.5"], "at most 1"),
        (["--noise", "nan"], "at least 0"),
        (["--horizon", "0"], "above 0"),
        (["--horizon", "0.0001"], "at least one step"),
        (["--plot", "figure.bmp"], "must end in .png, .svg or .pdf"),
        (["--plot", "/no/such/folder/figure.png"], "no folder"),
        (["--plot", f"{'long' * 75}.png"], "long.png: File name too long"),
        (["--law", "best"], "choose from"),
    ],
)
def test_what_cannot_be_simulated_is_refused_by_name(
    flags: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "turtlebot3_pair", *flags]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert named in err


def test_a_plot_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    figure = tmp_path / "figure.png"
    text, result = simulated(capsys, "--plot", str(figure))
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert result["plot"] == str(figure)
    assert str(figure) in text


def test_who_waits_at_a_terminal_for_the_law_to_be_compiled_is_told_so_until_it_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    told: list[str] = []

    @contextmanager
    def waiting(what: str) -> Iterator[None]:
        told.append(what)
        yield
        told.append("done")

    def steps(share: float) -> None:
        told.append(f"{share:g}")

    monkeypatch.setattr(simulate, "waiting", waiting)
    monkeypatch.setattr(Bar, "at", lambda _, share: steps(share))
    simulated(capsys)
    assert told[:3] == ["compiling the law; the first time that takes ten seconds and more", "done", "0"]
    assert told[-1] == "1"


def test_what_takes_long_shows_how_far_it_is_on_a_terminal_and_only_there() -> None:
    code = """
import sys
from deploy import simulate
from deploy.terminal import bar
bar.PATIENCE = 0.0
sys.exit(simulate.main(["turtlebot3_pair", "--runs", "3", "--horizon", "8"]))
"""
    ours, theirs = pty.openpty()
    try:
        environment = {**os.environ, "TERM": "xterm"}
        done = subprocess.run(
            [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=theirs, env=environment, check=False
        )
        shown = os.read(ours, 100_000).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    assert done.returncode == 0
    assert "turtlebot3-pair, 3 runs" in shown
    assert b"turtlebot3-pair, field law" in done.stdout
    quiet = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert quiet.stderr == ""
