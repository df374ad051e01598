"""Helpers that run commands of `formation`, and missions for `formation assign`."""

from __future__ import annotations

import json
import random
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from formation.deploy.cli import main

Capsys = pytest.CaptureFixture[str]


def output_of(capsys: Capsys, arguments: Sequence[str]) -> str:
    """Run a command that must succeed; return its output."""
    assert main(arguments) == 0
    return capsys.readouterr().out


def refused(capsys: Capsys, arguments: Sequence[str]) -> str:
    """Run a command that must end with exit code 2 and print only to stderr; return that."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return err


def assigned(capsys: Capsys, *arguments: str) -> dict[str, Any]:
    """Run `formation assign --json`; return its result."""
    capsys.readouterr()
    assert main(["assign", *arguments, "--json"]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def shuffled(shape: str = "grid", robots: int = 9, *flags: str) -> str:
    """Write a mission whose robots start near slots of other robots; return its path."""
    assert main(["new", shape, "--robots", str(robots), "--out", "mine.toml", "--force", *flags]) == 0
    path = Path("mine.toml")
    text = path.read_text(encoding="utf-8")
    line = re.compile(r"^start = .*heading.*$", re.MULTILINE)
    starts = line.findall(text)
    random.Random(3).shuffle(starts)
    path.write_text(line.sub(lambda _: starts.pop(), text), encoding="utf-8")
    return "mine.toml"
