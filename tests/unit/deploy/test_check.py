"""`formation check`: exit codes, text and JSON. Other tests check the figures themselves."""

from __future__ import annotations

import cmath
import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from formation.deploy import check
from formation.deploy.check import _eigenvalues, bounds, words
from formation.deploy.cli import main
from formation.mission.file import load, read, shipped
from formation.mission.model import Bounds
from formation.mission.route import Circle, Straight
from formation.stability import feasibility
from formation.stability.analysis import analyse
from tests.unit.deploy.commands import Capsys

KEYS = {
    "bounds", "ok", "problems", "warnings", "eigenvalues", "stable", "slowest_mode", "settling_time_estimate",
    "delay_margin", "depth", "amplification", "losses",
}  # fmt: skip


def ring(followers: int) -> str:
    """A directed ring of followers of which one measures the leader, with the paper's gains."""
    spots = [cmath.rect(5.0, math.tau * i / followers) for i in range(followers)]
    slots = "".join(f"r{i} = [{spot.real:.3f}, {spot.imag:.3f}]\n" for i, spot in enumerate(spots))
    robots = "".join(
        f"[robots.r{i}]\nneighbours = {[f'r{(i - 1) % followers}', *['leader'] * (i == 0)]}\n"
        f"start = {{ x = {spot.real:.3f}, y = {spot.imag:.3f} }}\n"
        for i, spot in enumerate(spots)
    )
    return (
        'name = "ring"\nleader = "leader"\n[law]\nkind = "paper"\nk_p = 2.0\nk_i = 1.0\n'
        f"[shapes.circle]\n{slots}[robots.leader]\nstart = {{ x = 0, y = 0 }}\n{robots}"
        "[[route]]\nspeed = 0.1\nheading_deg = 0\n"
    )


def checked(capsys: Capsys, *arguments: str) -> tuple[int, str, dict[str, Any]]:
    code = main(["check", *arguments, "--json"])
    out, words = capsys.readouterr()
    return code, words, json.loads(out)


@pytest.mark.parametrize("mission", shipped())
def test_check_of_shipped_mission_passes_without_warnings(mission: str, capsys: Capsys) -> None:
    code, out, result = checked(capsys, mission)
    assert code == 0
    assert set(result) >= KEYS
    assert result["ok"] is True
    assert result["problems"] == []
    # in two_chains each robot measures only the one before it, half a metre away
    assert [one for one in result["warnings"] if "could meet" not in one or mission != "two_chains"] == []
    assert result["depth"][load(mission).leader] == 0
    assert result["settling_time_estimate"] > 0.0
    assert ("no problem found\n" in out) is (not result["warnings"])
    assert ("no problem found, 1 warning\n" in out) is (len(result["warnings"]) == 1)
    assert all(f"\n  {name} " in out for name in load(mission).names)


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_unstable_mission_exits_with_1_and_advice(tmp_path: Path, capsys: Capsys) -> None:
    (tmp_path / "ring.toml").write_text(ring(12))
    code, out, result = checked(capsys, str(tmp_path / "ring.toml"))
    assert code == 1
    assert result["ok"] is False
    assert result["stable"] is False
    assert result["slowest_mode"] == pytest.approx(0.032, abs=0.001)
    assert "it cannot work" in out
    assert "problem: unstable" in out
    assert "without end" in out


@pytest.mark.slow
def test_check_uses_law_of_command_line(capsys: Capsys) -> None:
    _, out, result = checked(capsys, "six_robots", "--law", "paper")
    assert result["law"] == "paper"
    assert "six-robots, paper law" in out
    assert result["settling_time_estimate"] > 2.0 * checked(capsys, "six_robots")[2]["settling_time_estimate"]


def test_check_shows_that_it_compiles_the_law(monkeypatch: pytest.MonkeyPatch, capsys: Capsys) -> None:
    reported: list[str] = []

    @contextmanager
    def message_if_slow(what: str) -> Iterator[None]:
        reported.append(what)
        yield

    monkeypatch.setattr(check, "message_if_slow", message_if_slow)
    assert main(["check", "turtlebot3_pair"]) == 0
    assert reported == ["checking; with many robots, and the first time, this takes ten seconds and more"]
    assert "no problem found" in capsys.readouterr().out


def test_check_names_robots_that_hold_after_each_loss(capsys: Capsys) -> None:
    _, out, result = checked(capsys, "two_chains")
    found = analyse(load("two_chains"))
    assert result["depth"] == found.depth
    assert f"{found.settling_time_estimate:.1f} s from the mission's own starts" in out
    assert f"{found.delay_margin * 1e3:.0f} ms" in out
    assert "\n  left6 or right6 may be lost: the others go on\n" in out
    assert "\n  left4 lost: left5, left6 hold\n" in out
    assert "\n  right5 lost: right6 holds\n" in out
    assert "\n  leader lost: all others hold, for there is no standby\n" in out
    assert result["losses"]["left4"] == {"hold": ["left5", "left6"], "instead": {}}
    assert result["losses"]["left6"] == {"hold": [], "instead": {}}
    assert len(result["losses"]["leader"]["hold"]) == 12
    assert result["losses"]["leader"]["successor"] is None


def test_check_names_fallbacks_and_standbys_without_holding_robots(capsys: Capsys) -> None:
    _, out, result = checked(capsys, "patrol")
    assert "\n  any single follower may be lost: the others go on\n" in out
    assert "\n  robot1 lost: robot2 goes on by leader\n" in out
    assert "\n  leader lost: deputy leads within about 1 s\n" in out
    assert " hold" not in out
    assert "robot1, or else leader" in out
    assert result["losses"]["robot1"] == {"hold": [], "instead": {"robot2": ["leader"]}}
    assert result["losses"]["leader"] == {"hold": [], "instead": {}, "successor": "deputy"}


def test_check_warns_of_useless_fallback_neighbour(tmp_path: Path, capsys: Capsys) -> None:
    text = read("two_chains")[0].replace(
        'neighbours = ["left1"]', 'neighbours = ["left1"]\nfallback_neighbours = ["left3"]'
    )
    (tmp_path / "useless.toml").write_text(text)
    code, out, result = checked(capsys, str(tmp_path / "useless.toml"))
    assert code == 0
    assert any("left2.fallback_neighbours: left3 never helps" in warning for warning in result["warnings"])
    assert "warning: robots.left2.fallback_neighbours: left3 never helps" in out


def test_check_with_standby_needs_both_of_two_followers(tmp_path: Path, capsys: Capsys) -> None:
    text = read("turtlebot3_pair")[0] + "\n[standbys.deputy]\n"
    (tmp_path / "agree.toml").write_text(text)
    _, out, result = checked(capsys, str(tmp_path / "agree.toml"))
    assert "\n  robot1 lost: robot2 holds\n" in out
    assert result["losses"]["robot1"]["hold"] == ["robot2"]


@pytest.mark.usefixtures("paper_law_not_simulated")
def test_columns_align_with_titles_for_short_names(tmp_path: Path, capsys: Capsys) -> None:
    mission = tmp_path / "ring.toml"
    mission.write_text(ring(3).replace("leader", "l").replace('l = "l"', 'leader = "l"', 1))
    _, out, _ = checked(capsys, str(mission))
    lines = out.splitlines()
    title = next(number for number, text in enumerate(lines) if "measures" in text)
    assert lines[title].split()[:2] == ["robot", "hops"]
    rows = lines[title + 1 : title + 5]
    assert [text[lines[title].index("hops")] for text in rows] == ["0", "1", "2", "3"]


def test_eigenvalues_merge_pairs_and_repeats_slowest_first() -> None:
    text = _eigenvalues([-3.0 + 0j, -0.5 - 1j, -3.0 + 0j, -0.5 + 1j])
    assert text == "-0.5 ± 1i, -3 (2 times) 1/s"
    assert _eigenvalues([complex(-k) for k in range(1, 10)]).endswith("-6 and 3 more 1/s")


def test_check_prints_the_bounds() -> None:
    mission = load("six_robots")
    found = analyse(mission)
    assert "bounds           x -25.5 … 645.5 m, y -24.5 … 382 m, by default" in words(mission, found)
    assert bounds(mission)["default"] is True


def test_check_warns_where_route_and_shapes_leave_the_bounds() -> None:
    given = Bounds(x=(-5.0, 30.0), y=(-4.0, 1.2))
    route = (Straight(speed=0.2, heading_deg=0.0),)
    mission = load("six_robots").model_copy(update={"bounds": given, "route": route})
    found = list(feasibility.out_of_bounds(mission))
    assert found[0].startswith("the route leaves the bounds after 148 s, where the leader reaches x = 29.6 m")
    assert found[1].startswith("shape wedge leaves the bounds at the start")
    assert found[1].endswith("robot3's slot at y = 1 m, limit 0.8 m")


def test_check_prints_convergence_certificate_and_curve_errors() -> None:
    circle = Circle(radius=2.0, speed=0.2)
    straight = Straight(speed=0.2, heading_deg=0.0, duration=10.0)
    six, patrol = load("six_robots").changed(route=(straight, circle)), load("patrol")
    found = analyse(six)
    assert "comes into formation from every start (theorem 1)" in words(six, found)
    assert 0.0 < found.as_json()["certificate"]["curve_errors"]["robot6"] < 0.005
    assert "off by" in words(six, found)
    circling = six.changed(route=(circle,))
    assert "not from every start: the leader must drive straight" in words(circling, analyse(circling))
    assert "not from every start: the leader must be slower than robot1" in words(patrol, analyse(patrol))
