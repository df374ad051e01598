"""`formation simulate`: options, output and refusals. Other tests check the simulation itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from matplotlib.image import imread

from formation.deploy import simulate
from formation.deploy.cli import main
from formation.deploy.terminal.bar import Bar
from formation.mission.file import parse, read
from formation.simulation.body import PROFILES
from tests.unit.deploy.commands import Capsys, output_of, refused

SHORT = ("--horizon", "15")
FIGURES = Path(__file__).parents[3] / "docs" / "figures"


def simulated(capsys: Capsys, *arguments: str) -> tuple[str, dict[str, Any]]:
    short = () if "--horizon" in arguments else SHORT
    assert main(["simulate", "turtlebot3_pair", *short, *arguments, "--json"]) == 0
    out, words = capsys.readouterr()
    return words, json.loads(out)


def test_json_has_every_figure(capsys: Capsys) -> None:
    _, result = simulated(capsys, "--runs", "20", "--spread", "0.2", "--seed", "3")
    assert result["mission"] == "turtlebot3-pair"
    assert (result["runs"], result["seed"], result["law"]) == (20, 3, "field")
    assert result["converged_fraction"] == 1.0
    assert 0.0 < result["settling_time"]["median"] <= result["settling_time"]["p95"] < 15.0
    assert 0.0 <= result["final_error"]["median"] <= result["final_error"]["max"] < 0.05
    assert result["wall_time"] > 0.0
    assert result["robot_steps_per_second"] > 0.0


def test_missing_numba_prints_install_advice_once(monkeypatch: pytest.MonkeyPatch, capsys: Capsys) -> None:
    monkeypatch.setattr("formation.deploy.terminal.bar.AVAILABLE", False)
    words, _ = simulated(capsys, "--horizon", "1")
    assert words.count("pip install '.[simulate]' in a clone") == 1


def test_simulation_reports_ignored_scanners_and_obstacles(capsys: Capsys) -> None:
    assert main(["simulate", "posts", "--json"]) == 0
    out, words = capsys.readouterr()
    assert "  not simulated    scanners, posts, walls; formation run has them" in words.splitlines()
    assert json.loads(out)["not_simulated"] == ["scanners", "posts", "walls"]
    text, result = simulated(capsys)
    assert "not simulated" not in text
    assert result["not_simulated"] == []


ENDLESS = "speed = 0.05\nheading_deg = 0\n"
CORNER = f"{ENDLESS}duration = 5\n[[route]]\nspeed = 0.05\nheading_deg = 90\n"
ROUND = "speed = 0.05\nradius = 4\n"
TURNING = ("duration", "turning = true\nduration")


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ((), []),
        ((("[collisions]", "[cohesion]\nerror = 0.5\n[collisions]"),), ["cohesion"]),
        ((TURNING,), []),
        (((ENDLESS, CORNER),), []),
        (((ENDLESS, CORNER), TURNING), ["turning"]),
        (((ENDLESS, ROUND), TURNING), ["turning"]),
    ],
)
def test_left_out_names_unsimulated_mission_features(
    changes: tuple[tuple[str, str], ...], named: list[str]
) -> None:
    text = read("turtlebot3_pair")[0]
    for before, after in changes:
        assert before in text
        text = text.replace(before, after, 1)
    assert simulate.left_out(parse(text, "mission.toml")) == named


def test_touching_is_not_examined_with_collisions_off(tmp_path: Path, capsys: Capsys) -> None:
    text = read("turtlebot3_pair")[0].replace("[collisions]", '[collisions]\nmode = "off"')
    (tmp_path / "off.toml").write_text(text)
    assert main(["simulate", str(tmp_path / "off.toml"), *SHORT, "--json"]) == 0
    out, words = capsys.readouterr()
    assert "  bodies           not watched: collisions are off" in words.splitlines()
    assert json.loads(out)["touched"] is None


def test_single_run_uses_mission_starts_many_use_seed(capsys: Capsys) -> None:
    text, first = simulated(capsys)
    assert "the mission's own starts" in text
    assert simulated(capsys, "--seed", "9")[1]["settling_time"] == first["settling_time"]
    text, many = simulated(capsys, "--runs", "5", "--seed", "1")
    assert "5 random starts, seed 1" in text
    assert simulated(capsys, "--runs", "5", "--seed", "1")[1]["final_error"] == many["final_error"]
    assert simulated(capsys, "--runs", "5", "--seed", "2")[1]["final_error"] != many["final_error"]
    text, _ = simulated(capsys, "--spread", "0.2", "--seed", "4")
    assert "1 random start, seed 4" in text
    assert "the mission's own" not in text


@pytest.mark.slow
def test_report_states_that_paper_law_does_not_avoid(capsys: Capsys) -> None:
    text, result = simulated(capsys, "--runs", "20", "--seed", "1", "--law", "paper")
    assert f"bodies           touch in {result['touched']} of 20 runs" in text
    assert "; the paper law has no collision filter: robots do not avoid each other" in text
    assert (result["touched"] > 0) == (result["nearest"] < 0.0)


def test_report_states_touching_and_avoidance(capsys: Capsys) -> None:
    text = output_of(capsys, ["simulate", "six_robots", *SHORT])
    assert "bodies           none touch, " in text
    assert "avoid" not in text.partition("bodies")[2]
    some = output_of(capsys, ["simulate", "six_robots", "--runs", "40", *SHORT])
    assert "robots avoid only those that they measure: try --avoid" in some
    all_avoid = output_of(capsys, ["simulate", "six_robots", "--runs", "40", "--avoid", *SHORT])
    assert "touch in 0 of 40 runs" in all_avoid


def test_avoid_flag_without_effect_is_explained(capsys: Capsys) -> None:
    text = output_of(capsys, ["simulate", "turtlebot3_pair", "--law", "paper", "--avoid", "--horizon", "1"])
    assert "; the paper law has no collision filter: robots do not avoid each other\n" in text


@pytest.mark.slow
def test_law_flag_simulates_proportional_law(capsys: Capsys) -> None:
    text, result = simulated(capsys, "--law", "proportional")
    assert "proportional law" in text
    assert (result["law"], result["converged_fraction"]) == ("proportional", 1.0)


def test_runs_that_do_not_fit_into_memory_are_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    monkeypatch.setattr(simulate, "simulate", Mock(side_effect=MemoryError))
    err = refused(capsys, ["simulate", "six_robots", "--runs", "5000"])
    assert err == "formation: --runs 5000: more than fits into memory; take fewer\n"


def test_delay_loss_noise_and_quantised_flags_reach_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    called = Mock(side_effect=KeyboardInterrupt)
    monkeypatch.setattr(simulate, "simulate", called)
    flags = ["--delay", "0.1", "--loss", "0.2", "--noise", "0.003", "--quantised", "--law", "paper"]
    assert main(["simulate", "six_robots", *flags]) == 130
    options = called.call_args.kwargs["options"]
    assert (options.delay, options.loss) == (0.1, 0.2)
    assert options.body.position_noise == 0.003
    assert options.body.speed_step == PROFILES["turtlebot3_burger"].speed_step > 0.0
    assert called.call_args.kwargs["starts"] is None


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (["--runs", "0"], "at least 1"),
        (["--runs", "1000000000"], "at most 100000"),
        (["--runs", "1.5"], "--runs: '1.5': must be a whole number, at least 1 and at most 100000"),
        (["--delay", "1s"], "--delay: '1s': must be a number without a unit, at least 0 and at most 60 s;"),
        (["--delay", "-1"], "--delay: -1: must be at least 0 and at most 60 s;"),
        (["--loss", "1.5"], "at most 1"),
        (["--noise", "nan"], "--noise: nan: must be at least 0 and at most 10 m;"),
        (["--horizon", "0"], "above 0"),
        (["--horizon", "0.0001"], "at least one step"),
        (["--plot", "figure.bmp"], "must end in .png, .svg or .pdf"),
        (["--plot", f"{__file__}/folder/figure.png"], "test_simulate.py is a file, and no folder"),
        (["--plot", f"{'long' * 75}.png"], "long.png: File name too long"),
        (["--law", "best"], "--law: law 'best': must be one of field, paper, proportional;"),
        (["--dask", "desk"], "--dask: 'desk': must be HOST:PORT, such as tcp://192.168.1.5:8786"),
    ],
)
def test_illegal_flags_are_refused_with_reason(flags: list[str], named: str, capsys: Capsys) -> None:
    assert named in refused(capsys, ["simulate", "turtlebot3_pair", *flags])


def test_plot_flag_writes_figure(tmp_path: Path, capsys: Capsys) -> None:
    figure = tmp_path / "new" / "folder" / "figure.png"
    text, result = simulated(capsys, "--plot", str(figure))
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert result["plot"] == str(figure)
    assert str(figure) in text


@pytest.mark.slow
@pytest.mark.parametrize("law", ["field", "paper"])
def test_committed_figures_equal_figures_of_command(law: str, tmp_path: Path, capsys: Capsys) -> None:
    """Compare pixels: the fonts are matplotlib's own, and the tolerance covers other rounding of edges."""
    fresh = tmp_path / "figure.png"
    output_of(capsys, ["simulate", "six_robots", "--law", law, "--plot", str(fresh)])
    committed, drawn = (
        np.asarray(imread(path))[..., :3] for path in (FIGURES / f"six_robots_{law}.png", fresh)
    )
    assert committed.shape == drawn.shape
    assert (np.abs(committed - drawn).max(axis=2) > 0.2).mean() < 0.002


def test_terminal_shows_progress_while_law_is_compiled(
    monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    reported: list[str] = []

    @contextmanager
    def message_if_slow(what: str) -> Iterator[None]:
        reported.append(what)
        yield
        reported.append("done")

    monkeypatch.setattr(simulate, "message_if_slow", message_if_slow)
    monkeypatch.setattr(Bar, "at", lambda _, share: reported.append(f"{share:g}"))
    simulated(capsys)
    assert reported[:3] == ["compiling the law; the first time that takes ten seconds and more", "done", "0"]
    assert reported[-1] == "1"
