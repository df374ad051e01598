"""What commands print when no process answers."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import pytest

from formation.deploy.links import no_answer_message
from formation.mission.file import load

FOUND, GIVEN, FIELD = (
    "a run that found its usual ports taken has printed the -e flags that are needed here",
    "see that these are the endpoints of agents and leader, and that no firewall is between",
    "formation doctor field says which robots can be reached, and why others cannot",
)


@pytest.mark.parametrize(
    ("mission", "connect", "config", "remedy"),
    [
        ("six_robots", [], None, FOUND),
        ("six_robots", ["tcp/192.168.1.11:7460"], None, GIVEN),
        ("field", [], Path("field/desk/operator.json5"), FIELD),
    ],
)
def test_no_answer_names_the_remedy_that_fits(
    mission: str, connect: list[str], config: Path | None, remedy: str
) -> None:
    options = Namespace(mission=mission, connect=connect, config=config)
    message = no_answer_message(load("six_robots"), options, "operator")
    assert f"  - {remedy}\n" in message
    assert ("formation run" in message) == (config is None)  # a field does not run on this machine
    assert "?" not in message


def test_silent_robots_with_certificates_are_asked_by_their_bundles() -> None:
    options = Namespace(mission="pair.toml", connect=["tls/192.168.1.11:7460"], config=None)
    message = no_answer_message(load("turtlebot3_pair"), options, "operator")
    remedy = "name the folder of their bundles in place of the mission file, or the operator's configuration"
    assert f"  - robots with certificates answer only the operator: {remedy} with -c FILE\n" in message
    assert "formation run" not in message
