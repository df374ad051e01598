"""What a real session refuses is counted to the last message, and what the process says is whole."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.field.missions import in_the_field
from tests.field.sessions import attacking, prepared
from tests.support.child import PATIENCE, Child, free_endpoint, started

pytestmark = pytest.mark.processes
FLOOD, STEP = 20_000, 100
KIND = "put robot1/position by robot2"


def last(child: Child) -> dict[str, Any]:
    """What it says at its end; all before must be whole lines."""
    while True:
        line = child._lines.get(timeout=PATIENCE)
        assert line is not None, child.errors
        result: dict[str, Any] = json.loads(line)
        if result["event"] == "end":
            return result


def test_refused_flood_is_counted_completely_without_side_effects(tmp_path: Path) -> None:
    port = free_endpoint().rpartition(":")[2]
    mission = in_the_field("six_robots", lambda i: f"tls/127.0.0.{i + 1}:{port}", team="reds")
    desk = prepared(mission, tmp_path / "secrets")
    identity = desk.folder / "robot2"
    with started("tests.field.refusing", str(desk.file("robot3")), "reds") as child:
        child.event("ready")
        with attacking(identity, [desk.endpoint("robot3")], identity / "ca.pem", "reds") as attacker:
            block = zenoh.CongestionControl.BLOCK
            turn = child.event("turn")
            for sent in range(STEP, FLOOD + 1, STEP):
                for _ in range(STEP):
                    attacker.put("robot1/position", b"forged", congestion_control=block)
                    attacker.put("robot2/position", b"honest", congestion_control=block)
                while turn["refused"].get(KIND, 0) < sent:
                    later = child.event("turn")
                    assert later["number"] == turn["number"] + 1  # nothing that it says is lost or torn
                    turn = later
        assert child.signal(signal.SIGTERM) < 5.0
        result = last(child)
    assert result["refused"] == {KIND: FLOOD}
    assert result["received"]["robot2/position"] == FLOOD
    assert result["grown"] < 8 * 2**20
    assert result["longest"] < 0.5
    assert "refused: put robot1/position by robot2, 10000 times" in child.errors
    assert child.errors.count("refused:") < 10
