"""Robots among posts that only their scanners see, as real processes; and what they do without scans."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import combinations, groupby
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from mcap.reader import make_reader

from formation.control.unicycle import AT_REST, Command
from formation.deploy.local.plan import programs
from formation.deploy.local.ports import Ports
from formation.mission.file import load
from formation.monitor.recording.reader import read
from formation.protocol.reasons import Code
from formation.ros2.messages import LaserScan, Pose, Twist, decode
from formation.topics import CMD_VEL, GROUND_TRUTH, SCAN
from tests.processes.deploy.test_verify import commands, like, verified, whole
from tests.processes.fleet.driven import Page, under_way
from tests.processes.monitor.test_recording_elsewhere import check
from tests.support.child import PATIENCE, Child
from tests.support.child import started as child_started
from tests.support.launched import formed, started, wait_until_running

pytestmark = pytest.mark.processes
POSTS = load("posts")


class Recorded(NamedTuple):
    """A run of the mission: what it came to, its recording, and one that began on the way."""

    result: dict[str, Any]
    whole: Path
    late: Path


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("posts")
    with started("posts", "--duration", "110", "--record", "run.mcap", folder=folder) as process:
        lines = [child.cmdline() for child in wait_until_running(process, 14.0)]
        monitor = next(line for line in lines if line[3] == "formation.monitor")
        with like(monitor, folder, "--no-page", record=str(folder / "late.mcap")):
            wait_until_running(process, 30.0)
        wait_until_running(process, POSTS.duration - 6.0)
        result = formed(process, 0.01, within=POSTS.duration)
    assert process.returncode == 0
    return Recorded(result, folder / "run.mcap", folder / "late.mcap")


def truths(recording: Path) -> dict[str, list[Pose]]:
    """Where every robot really was."""
    found: dict[str, list[Pose]] = {name: [] for name in POSTS.followers}
    keys = {GROUND_TRUTH.key(name): name for name in POSTS.followers}
    for message in read(recording).messages():
        if message.sample.key in keys:
            found[keys[message.sample.key]].append(decode(Pose, message.sample.payload))
    return found


def test_robots_pass_posts_and_wall_and_reform(run: Recorded) -> None:
    assert run.result["converged"]
    assert run.result["formation_error"] < 0.01
    assert run.result["settling_time"] > 30.0  # the last of them is past the wall only then
    assert run.result["lost"] == 0
    ways, radius = truths(run.whole), POSTS.robot.radius
    for poses in ways.values():
        assert len(poses) > 900
        for pose in poses:
            gaps = [
                abs(pose.position - at) - size for at, size in (one.disc for one in POSTS.simulation.posts)
            ]
            gaps += [_from_wall(pose.position, *wall.line) for wall in POSTS.simulation.walls]
            assert min(gaps) > radius
    for one, other in combinations(ways.values(), 2):
        for pose, at_the_time in zip(one, _beside(one, other), strict=True):
            assert abs(pose.position - at_the_time) > 2.0 * radius


def _from_wall(here: complex, begin: complex, end: complex) -> float:
    along = ((here - begin) / (end - begin)).real
    return abs(here - begin - min(max(along, 0.0), 1.0) * (end - begin))


def _beside(poses: list[Pose], others: list[Pose]) -> Iterator[complex]:
    """Where the other was at the moments of `poses`, on the line between two of its own."""
    number = 0
    for pose in poses:
        while number + 2 < len(others) and others[number + 1].stamp < pose.stamp:
            number += 1
        before, after = others[number], others[number + 1]
        share = min(max((pose.stamp - before.stamp) / (after.stamp - before.stamp), 0.0), 1.0)
        yield before.position + share * (after.position - before.position)


def test_scans_are_recorded_as_ros_2_has_them_and_read_elsewhere(run: Recorded) -> None:
    counts = check([run.whole])
    with run.whole.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {one.topic: summary.schemas[one.schema_id] for one in summary.channels.values()}
    for name in POSTS.followers:
        topic = f"/{SCAN.key(name)}"
        assert counts[topic] > 200
        assert schemas[topic].name == "sensor_msgs/msg/LaserScan"
        assert b"float32[] ranges" in schemas[topic].data


def test_every_command_is_computed_again_to_the_last_bit(run: Recorded) -> None:
    whole(run.whole)


def test_late_recording_is_reproduced_from_agent_state(run: Recorded) -> None:
    code, text, result = verified(run.late)
    assert code == 0, text
    lost = missing_keys(run.late, run.whole)
    for one in result["robots"].values():
        assert one["exact"] == one["compared"] > 50, text
        beginning, *others = one["not_judged"]
        assert "beginning is not in the recording" in beginning["reason"]
        for stretch in others:  # only where this monitor really lost a message, as it may on a busy machine
            assert "is missing in the recording" in stretch["reason"], stretch
            if stretch["commands"] == 1 and stretch["since"] > result["length"] - 0.1:
                continue  # the recording ended between a command and what it follows from
            assert any(f" {key} " in stretch["reason"] for key in lost), (stretch, lost)


def missing_keys(recording: Path, whole: Path) -> set[str]:
    """Return the keys of messages that `recording` lacks, of those that `whole` has in the same time."""
    found = [
        (message.wall, message.sample.key, message.sample.payload) for message in read(recording).messages()
    ]
    has = {(key, payload) for _, key, payload in found}
    begin, end = found[0][0] + 1.0, found[-1][0] - 1.0
    return {
        message.sample.key
        for message in read(whole).messages()
        if begin < message.wall < end and (message.sample.key, message.sample.payload) not in has
    }


# Without scans


@contextmanager
def scanning(record: Path) -> Iterator[tuple[dict[str, Child], Page]]:
    """All processes of the mission, under way, in a world whose scanners can be blinded."""
    with ExitStack() as stack:
        where = stack.enter_context(Ports(POSTS)).endpoints
        children, ready = {}, {}
        for program in programs(
            POSTS, "posts", where, parent=os.getpid(), record=record, page=("--page", "127.0.0.1:0"),
            patience=PATIENCE,
        ):  # fmt: skip
            module, *arguments = program.argv[program.argv.index("-m") + 1 :]
            instead = "tests.processes.fleet.blind_robots" if program.name == "robots" else module
            children[program.name] = stack.enter_context(child_started(instead, *arguments))
        for name, child in children.items():
            ready[name] = child.event("ready")
        page = Page(ready["monitor"]["page"])
        page.until(under_way)
        yield children, page


def all_hold(why: Code | None = None) -> Callable[[dict[str, Any]], bool]:
    """Whether every follower says that it holds, and for this reason if one is given."""
    codes = {why} if why else set(Code)
    return lambda snapshot: all(
        snapshot["robots"][name]["state"] == "hold" and snapshot["robots"][name]["reason_code"] in codes
        for name in POSTS.followers
    )


def test_robots_hold_until_their_scans_return(tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    with scanning(record) as (children, page):
        os.kill(children["robots"].pid, signal.SIGUSR1)
        page.until(all_hold(Code.SCAN_SILENT))
        held = time.time()
        os.kill(children["robots"].pid, signal.SIGUSR2)
        page.until(under_way)
        os.kill(children["robots"].pid, signal.SIGKILL)
        page.until(all_hold())
        children["monitor"].signal(signal.SIGTERM)
    blind_ones = blindness(record, held)
    assert set(blind_ones) == set(POSTS.followers)
    for name, blind in blind_ones.items():
        stands = [stands for stands, _ in groupby(blind.commands, lambda command: command == AT_REST)]
        # it drove, stood, and may have been told to go on before the scan that let it is recorded
        assert stands[stands.index(False) :] in ([False, True], [False, True, False]), name
    code, text, _ = verified(record)
    assert code == 0, text
    assert min(commands(record).values()) > 0


class Blindness(NamedTuple):
    """A time without a scan, between two scans of one robot."""

    lasted: float
    """[s]"""
    stood_after: float
    """From the last scan to the first command of zero velocity [s]."""
    commands: list[Command]
    """In that time."""


def blindness(recording: Path, moment: float) -> dict[str, Blindness]:
    """Of every robot, around a moment of the recorder's clock [s]."""
    found: dict[str, Blindness] = {}
    since = dict.fromkeys(POSTS.followers, math.nan)
    reported: dict[str, list[tuple[float, Command]]] = {name: [] for name in POSTS.followers}
    for message in read(recording).messages():
        name, _, topic = message.sample.key.partition("/")
        if topic == SCAN.name:
            decode(LaserScan, message.sample.payload)
            if since[name] < moment < message.wall:
                stood = (at - since[name] for at, command in reported[name] if command == AT_REST)
                each = [command for _, command in reported[name]]
                found[name] = Blindness(message.wall - since[name], next(stood, math.inf), each)
            since[name], reported[name] = message.wall, []
        elif topic == CMD_VEL.name:
            twist = decode(Twist, message.sample.payload)
            reported[name].append((message.wall, Command(twist.speed, twist.turn_rate)))
    return found
