"""A watchdog with a simulated robot and an agent played by the test: when it sends zero, and when not.

How often it sends zero is tested on a simulated clock (`tests/unit/agent/test_watchdog.py`); here, that zero
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
TWIST, STAMPED = ("ros2dds", "twist"), ("rmw_zenoh", "twist_stamped")
"""Both ROS 2 transports, each with another type of command."""


@pytest.fixture
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Scene]:
    with ExitStack() as stack:
        yield Scene(stack, tmp_path, *getattr(request, "param", TWIST))


def log_after_end(child: Child) -> str:
    """End a watchdog; return its log."""
    child.signal(signal.SIGTERM)
    published = child.event("summary")["robot"]["published"]
    assert child.wait() == 0
    assert set(published) <= {COMMAND}
    return child.errors


def wait_until_parked(watchdog: Child, times: int = 1) -> None:
    """Wait until a watchdog has parked its robot this many times."""
    until(lambda: watchdog.log.count(PARKED) == times)


def zero_was_sent_for_parking_time(scene: Scene, zeros: list[float]) -> bool:
    """Whether zero was sent for `PARKING_TIME`, apart from stalls of this machine and late reception here.

    This process has a lower priority than the watchdog.
    """
    start, end = zeros[0], zeros[-1]
    stood_still = end + PERIOD - start - scene.time_without_stalls(start, end + PERIOD)
    return abs(end + PERIOD - start - PARKING_TIME) <= PERIOD + stood_still + scene.max_delay(start, end)


@pytest.mark.parametrize("scene", [STAMPED], ids=["rmw_zenoh"], indirect=True)
def test_watchdog_stops_robot_of_silent_agent_until_farewell(scene: Scene) -> None:
    scene.robot()
    watchdog = scene.watchdog()
    wait_until_parked(watchdog)
    _check_ending_agent_sends_farewell(scene, watchdog)
    scene.listen()
    _check_robot_of_silent_agent_is_stopped(scene, watchdog)
    _check_once_replaces_missing_farewell(scene, watchdog)
    log = log_after_end(watchdog)
    assert "watching" in log
    assert "THE AGENT IS SILENT" in log


def _check_ending_agent_sends_farewell(scene: Scene, watchdog: Child) -> None:
    links = ["-l", free_endpoint(), "-e", free_endpoint(), "--robot-connect", scene.endpoint]
    began = time.time()
    flags = [str(scene.file), "--robot", "robot2", *links]
    with started("formation.agent", *flags, nice=NICE["formation.agent"]) as agent:
        agent.event("ready")
        until(lambda: len(scene.signs_of_life(began)) > 20)
        agent.signal(signal.SIGTERM)
        assert agent.event("summary")["robot"]["published"][LIFE] > 10
    until(lambda: watchdog.log.rstrip().endswith(PARKED))
    silent = watchdog.log.count("SILENT")
    assert silent <= gaps(scene.signs_of_life(began)), "the farewell came too late or never"
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}


def _check_robot_of_silent_agent_is_stopped(scene: Scene, watchdog: Child) -> None:
    assert {one.speed for one in scene.drive(1.0, alive=True)} == {SPEED}
    silent = scene.drove
    assert scene.time_without_stalls(silent, scene.wait_for_standstill(silent).moment) < 0.4
    for _ in range(10):
        assert scene.time_obeyed(scene.command()) <= 4.0 * PERIOD, "a late command was obeyed for too long"
    before, left = watchdog.log.count(PARKED), scene.send_farewell()
    wait_until_parked(watchdog, before + 1)
    assert scene.next_odometry().speed == 0.0
    assert zero_was_sent_for_parking_time(scene, scene.times_of_zero(left))
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}, "it cannot be driven by hand"


def _check_once_replaces_missing_farewell(scene: Scene, watchdog: Child) -> None:
    scene.drive(1.0, alive=True)
    scene.wait_for_standstill(scene.drove)
    before = watchdog.log.count(PARKED)
    once = scene.watchdog("--once")
    published = once.event("summary")["robot"]["published"]
    assert set(published) == {COMMAND, LIFE}
    assert 1 < published[COMMAND] <= PARKING_TIME / PERIOD
    assert published[LIFE] == 1
    assert once.wait() == 0
    wait_until_parked(watchdog, before + 1)
    assert {one.speed for one in scene.drive(1.0, alive=False)} == {SPEED}


def test_watchdog_ended_while_braking_sends_zero_last(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    watchdog = scene.watchdog()
    scene.drive(0.5, alive=True)
    silent = scene.drove

    def sends_zero_slowly() -> bool:
        """Whether zero is sent only once a second by now, and has just been sent."""
        zeros = scene.times_of_zero(silent)
        return (
            len(zeros) > 2
            and zeros[-2] - zeros[0] > BRAKING_TIME - SLOW_PERIOD
            and zeros[-1] - zeros[-2] > 0.9 * SLOW_PERIOD
        )

    until(sends_zero_slowly)
    sent = scene.command()
    until(lambda: SPEED in {one.speed for one in scene.odometry(sent)})  # the command has arrived
    drove = next(one.moment for one in scene.odometry(sent) if one.speed == SPEED)
    assert "SIGTERM" in log_after_end(watchdog)
    until(lambda: scene.last_speed() == 0.0)
    stood = scene.wait_for_standstill(drove).moment  # it also stood before the command to drive had arrived
    assert scene.next_odometry().speed == 0.0
    assert {one.speed for one in scene.odometry(stood)} == {0.0}


@pytest.mark.smoke
def test_once_stops_robot_without_watchdog(scene: Scene) -> None:
    scene.robot()
    scene.listen()
    assert scene.drive(0.5, alive=True)[-1].speed == SPEED
    assert scene.watchdog("--once").wait() == 0
    assert scene.next_odometry().speed == 0.0
    assert zero_was_sent_for_parking_time(scene, scene.times_of_zero())
    assert {one.speed for one in scene.odometry(scene.times_of_zero()[-1])} == {0.0}


def test_once_exits_1_when_no_robot_listens(scene: Scene) -> None:
    started_at = time.monotonic()
    nowhere = ("--robot", "robot2", "--robot-connect", free_endpoint(), "--once")
    with (
        started("formation.agent.watchdog", str(scene.file), *nowhere) as unlinked,
        Bus(BusConfig(listen=(scene.endpoint,), mode="router")),
    ):
        assert scene.watchdog("--once").wait() == 1
        assert unlinked.wait() == 1
    assert time.monotonic() - started_at < 20.0
