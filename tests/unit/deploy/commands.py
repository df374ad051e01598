"""Commands of `formation` as a test runs them, and missions that give `formation assign` something to do."""

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
    """What a command that succeeds prints."""
    assert main(arguments) == 0
    return capsys.readouterr().out


def refused(capsys: Capsys, arguments: Sequence[str]) -> str:
    """What a command says that ends with exit code 2 and prints nothing else."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    return err


def assigned(capsys: Capsys, *arguments: str) -> dict[str, Any]:
    """What `formation assign` says to a machine."""
    capsys.readouterr()
    assert main(["assign", *arguments, "--json"]) == 0
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


def shuffled(shape: str = "grid", robots: int = 9, *flags: str) -> str:
    """A mission whose robots start near slots that are not theirs."""
    assert main(["new", shape, "--robots", str(robots), "--out", "mine.toml", "--force", *flags]) == 0
    path = Path("mine.toml")
    text = path.read_text(encoding="utf-8")
    line = re.compile(r"^start = .*heading.*$", re.MULTILINE)
    starts = line.findall(text)
    random.Random(3).shuffle(starts)
    path.write_text(line.sub(lambda _: starts.pop(), text), encoding="utf-8")
    return "mine.toml"
