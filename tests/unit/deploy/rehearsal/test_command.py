"""`formation rehearse`: what it prints and how it ends."""

from __future__ import annotations

import json
from typing import Any

import pytest

from formation.deploy.refusal import Refusal
from formation.deploy.rehearse import main


def told(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json"]) in {0, 1}
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_calm_run_holds_every_rule(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["six_robots", "--faults", "none"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("six-robots, 1 seed, faults: none\n  every rule held  1 of 1\n")


def test_failing_run_is_told_with_its_command(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("formation.agent.core.Agent.tell", lambda *_: 1 // 0)
    arguments = ("six_robots", "--fault", "robot1:stop@8+5")
    assert main(arguments) == 1
    out = capsys.readouterr().out
    assert "  seed 0: exception: " in out
    assert "    formation rehearse six_robots --seed 0 --faults none\n" in out
    report = told(capsys, *arguments)
    assert report["failed"] == 1
    assert report["runs"][0]["violations"][0]["rule"] == "exception"


def test_noise_is_stated_and_seeds_are_counted(capsys: pytest.CaptureFixture[str]) -> None:
    report = told(capsys, "turtlebot3_pair", "--faults", "clock,full", "--seeds", "2", "--noise", "0.001")
    assert [run["seed"] for run in report["runs"]] == [0, 1]
    kinds = {
        fault.split(":")[1].split("@")[0].split("=")[0] for run in report["runs"] for fault in run["faults"]
    }
    assert kinds <= {"clock", "full"}


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["--faults", "kill,melt"], "--faults 'melt': must be all, none, or some of loss, "),
        (["--fault", "robot2:melt@3"], "--fault 'robot2:melt@3': melt: must be one of "),
    ],
)
def test_illegal_faults_are_refused(arguments: list[str], why: str) -> None:
    with pytest.raises(Refusal) as refused:
        main(["six_robots", *arguments])
    assert str(refused.value).startswith(why)
