"""The stopwatches of the agent that is profiled."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.processes

CODE = """
from formation.agent.core import Agent
from formation.control.laws import LAWS
from formation.mission.file import load
from tests.campaigns.bench.profiled_agent import Profile, install

install(Profile())
agent = Agent(load("six_robots"), "robot2")
assert agent.controller.step is not LAWS["field"].step
"""


def test_step_of_the_law_is_timed() -> None:
    """In a process of its own, as stopwatches stay in."""
    subprocess.run([sys.executable, "-c", CODE], check=True)
