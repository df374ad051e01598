"""The command line as a process: closed pipes, terminals, progress and JSON output."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import pytest

from formation.deploy import cli
from tests.field.deployed import TEXT


def test_closed_stdout_causes_no_traceback() -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "formation.deploy", "missions"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.stderr is not None
        assert process.stderr.read() == ""


def test_help_escapes_unicode_for_ascii_output() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "formation.deploy", "simulate", "--help"],
        env={**os.environ, "PYTHONIOENCODING": "ascii", "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "within \\xb1 this of the slots" in done.stdout


def test_progress_is_shown_only_on_terminal() -> None:
    code = """
import sys
from formation.deploy import simulate
from formation.deploy.terminal import bar
bar.PROGRESS_DELAY = 0.0
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


@pytest.mark.parametrize(
    "line",
    [
        "missions",
        "check turtlebot3_pair",
        "simulate turtlebot3_pair --horizon 1",
        "new wedge --robots 3",
        "assign six_robots --dry-run",
        "order turtlebot3_pair stop --timeout 0.1 -e tcp/127.0.0.1:9",
        "watch turtlebot3_pair --once -e tcp/127.0.0.1:9",
        "doctor turtlebot3_pair --seconds 0.5",
        "deploy certificates field.toml --out secrets",
        "deploy bundle field.toml --certificates secrets --out bundles --no-wheels",
    ],
)
def test_json_flag_prints_only_json_on_stdout(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("formation.deploy.watch.COMPLETE_TIMEOUT_SECONDS", 0.1)
    Path("field.toml").write_text(TEXT, encoding="utf-8")
    if "bundle" in line:
        assert cli.main(["deploy", "certificates", "field.toml", "--out", "secrets"]) == 0
        capsys.readouterr()
    assert cli.main([*line.split(), "--json"]) in {0, 1}
    assert json.loads(capsys.readouterr().out)
