"""A watchdog beside a simulated robot, whose agent is played here: whom it stops, and whom it leaves alone.

How often it says zero is counted on a simulated clock (`tests/unit/agent/test_watchdog.py`); here, that it
arrives.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from formation.agent.watchdog.core import BRAKING_TIME, PARKING_TIME, SLOW_PERIOD
from formation.transport.bus import Bus, BusConfig
from tests.processes.agent.watchdog_scene import COMMAND, LIFE, NICE, PARKED, PERIOD, SPEED, Scene, gaps
from tests.support.child import Child, free_endpoint, started, until

pytestmark = pytest.mark.processes


TWIST = ("ros2dds", "twist")
both = pytest.mark.parametrize(
    "scene", [TWIST, ("rmw_zenoh", "twist_stamped")], ids=lambda wire: wire[0], indirect=True
)
"""Both spellings, each with another type of command."""


@pytest.fixture
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(stack, tmp_path, *getattr(request, "param", TWIST))


def ended(child: Child) -> str:
    """End a watchdog; its log."""
    child.signal(signal.SIGTERM)
    published = child.event("summary")["robot"]["published"]
    assert child.wait() == 0
    assert set(published) <= {COMMAND}
    return child.errors


def parked(watchdog: Child, times: int = 1) -> None:
    """Wait until a watchdog has parked its robot so often."""
    until(lambda: watchdog.log.count(PARKED) == times)


def said_for_half_a_second(scene: Scene, zeros: list[float]) -> bool:
    """Whether zero was said for so long to park a robot, but for times when this machine stood still.

    And but for how late it was heard here: this process waits for its turn longer than the watchdog.
    """
    start, end = zeros[0], zeros[-1]
    stood_still = end + PERIOD - start - scene.ran(start, end + PERIOD)
    return abs(end + PERIOD - start - PARKING_TIME) <= PERIOD + stood_still + scene.late(start, end)


@both
def test_silent_agents_robot_stays_stopped_until_farewell(
    scene: Scene,
) -> None:
    scene.robot()
    scene.listen()
    watchdog = scene.watchdog()
    assert {one.speed for one in scene.drive(1.0, alive=True)} == {SPEED}
    silent = scene.drove
    assert scene.ran(silent, scene.stands(silent).moment) < 0.4
    for _ in range(10):
        assert scene.obeyed(scene.command()) <= 4.0 * PERIOD, "a late command was obeyed for long"
    before, left = watchdog.log.count(PARKED), scene.leave()
    parked(watchdog, before + 1)
    assert scene.newest().speed == 0.0
    assert said_for_half_a_second(scene, scene.zeros(left))
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}, "driven by hand"
    assert "THE AGENT IS SILENT" in ended(watchdog)


@pytest.mark.smoke
def test_watchdog_ended_while_braking_sends_zero_last(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    watchdog = scene.watchdog()
    scene.drive(0.5, alive=True)
    silent = scene.drove

    def slowly() -> bool:
        """Whether by now it says zero each second only, and has just done so."""
        zeros = scene.zeros(silent)
        return (
            len(zeros) > 2
            and zeros[-2] - zeros[0] > BRAKING_TIME - SLOW_PERIOD
            and zeros[-1] - zeros[-2] > 0.9 * SLOW_PERIOD
        )

    until(slowly)
    sent = scene.command()
    until(lambda: SPEED in {one.speed for one in scene.wheels(sent)})  # it has come
    drove = next(one.moment for one in scene.wheels(sent) if one.speed == SPEED)
    assert "SIGTERM" in ended(watchdog)
    until(lambda: scene.last_word() == 0.0)
    stood = scene.stands(drove).moment  # it stood after it was told to drive, too, until that had come
    assert scene.newest().speed == 0.0
    assert {one.speed for one in scene.wheels(stood)} == {0.0}


@both
def test_ending_agent_sends_farewell_and_allows_manual_driving(
    scene: Scene,
) -> None:
    scene.robot()
    watchdog = scene.watchdog()
    parked(watchdog)
    links = ["-l", free_endpoint(), "-e", free_endpoint(), "--robot-connect", scene.endpoint]
    began = time.time()
    flags = [str(scene.file), "--robot", "robot2", *links]
    with started("formation.agent", *flags, nice=NICE["formation.agent"]) as agent:
        agent.event("ready")
        until(lambda: len(scene.signs(began)) > 20)
        agent.signal(signal.SIGTERM)
        assert agent.event("summary")["robot"]["published"][LIFE] > 10
    until(lambda: watchdog.log.rstrip().endswith(PARKED))
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    log = ended(watchdog)
    assert "watching" in log
    assert log.count("SILENT") <= gaps(scene.signs(began)), "it took its leave too late, or not at all"


@both
def test_once_stops_robot_and_replaces_missing_farewell(scene: Scene) -> None:
    scene.robot()
    watchdog = scene.watchdog()
    scene.drive(1.0, alive=True)
    scene.stands(scene.drove)
    before = watchdog.log.count(PARKED)
    once = scene.watchdog("--once")
    published = once.event("summary")["robot"]["published"]
    assert set(published) == {COMMAND, LIFE}
    assert 1 < published[COMMAND] <= PARKING_TIME / PERIOD
    assert published[LIFE] == 1
    assert once.wait() == 0
    parked(watchdog, before + 1)
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}
    assert "driven by hand" in ended(watchdog)


@pytest.mark.smoke
def test_once_stops_a_robot_that_has_no_watchdog(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    assert scene.drive(0.5, alive=True)[-1].speed == SPEED
    assert scene.watchdog("--once").wait() == 0
    assert scene.newest().speed == 0.0
    assert said_for_half_a_second(scene, scene.zeros())
    assert {one.speed for one in scene.wheels(scene.zeros()[-1])} == {0.0}


def test_once_says_by_its_exit_code_that_no_robot_listened(scene: Scene) -> None:
    started_at = time.monotonic()
    assert scene.watchdog("--once").wait() == 1
    with Bus(BusConfig(listen=(scene.endpoint,), mode="router")):
        assert scene.watchdog("--once").wait() == 1
    assert time.monotonic() - started_at < 20.0
