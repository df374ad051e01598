"""The monitor as a real process, watching a fleet that this test plays over real Zenoh."""

from __future__ import annotations

import signal
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import pytest

from formation.monitor.__main__ import main
from formation.monitor.metrics.keys import OWN
from formation.monitor.recording.reader import read
from formation.ros2.messages import Diagnostics, Number, decode
from formation.ros2.naming import Naming
from formation.topics import DIAGNOSTICS, ERROR, GROUND_TRUTH, ODOM, STATUS
from formation.transport.bus import Bus, BusConfig
from formation.wire import Sample
from tests.conftest import MAX_RUNS_IN_STALLS, MIN_STALL_SECONDS
from tests.processes.agent.actor import KEYS, Actor, events, recorded, router, watching
from tests.support.child import PATIENCE, free_endpoint, started, until
from tests.support.zenoh_admin import inspect

pytestmark = pytest.mark.processes


ROS = Naming.of_formation("rmw_zenoh", 7)
"""Spelling of topics of a ROS 2 that no robot of the mission has."""


class Run(NamedTuple):
    """Results of three seconds of a fleet in formation."""

    actor: Actor
    arrived: list[Sample]
    """What the fleet received from the monitor."""
    in_ros: list[Sample]
    """What ROS 2 received."""
    snapshots: list[dict[str, Any]]
    summary: dict[str, Any]
    path: Path
    in_file: dict[str, list[bytes]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Play a run, up to three times until the machine did not stand still: a failed test plays none anew."""
    for _ in range(MAX_RUNS_IN_STALLS):
        one = play(tmp_path_factory.mktemp("run"))
        if one.actor.held_up < MIN_STALL_SECONDS:
            break
    return one


def play(folder: Path) -> Run:
    path, end = folder / "new" / "run.mcap", free_endpoint()
    flags = (
        "--record",
        str(path),
        "--snapshots",
        "--ros",
        end,
        "--ros-names",
        "rmw_zenoh",
        "--ros-domain",
        "7",
    )
    with watching(*flags) as (child, actor), router(end) as ros:
        for key in (*(one.key for one in OWN), "robot1/**", "robot2/**"):
            actor.bus.subscribe(key)
        actor.stage.subscribe("**")
        ros.subscribe("**")  # the router starts after the monitor, which does not wait for it
        until(lambda: ros.received[ROS.wire(DIAGNOSTICS.key())])  # without a fleet, no others are published
        actor.play(3.0)
        actor.wait_until_recorded(path)
        child.signal(signal.SIGTERM)
        snapshots, summary = events(child)
        assert child.wait() == 0
        in_file, in_ros = recorded(path), list[Sample]()

        def all_received() -> bool:
            in_ros.extend(ros.drain())
            newest = {sample.key: sample.payload for sample in in_ros}
            return newest == {ROS.wire(one.key): in_file[one.key][-1] for one in OWN}

        until(all_received)
        return Run(actor, actor.bus.drain(), in_ros, snapshots, summary, path, in_file)


@pytest.mark.smoke
def test_every_published_message_is_recorded_exactly(run: Run) -> None:
    published = run.actor.published
    assert sum(published.values()) == 60 * (6 + 3 * 5) + 6 * 6
    assert run.summary["received"] == run.actor.bus.published
    assert run.summary["robot"]["received"] == run.actor.stage.published
    assert run.summary["recorded"] == published + Counter(run.summary["published"])
    assert run.summary["recorded"] == {key: len(payloads) for key, payloads in run.in_file.items()}
    for key in published:
        assert run.in_file[key] == [sample.payload for sample in run.actor.sent if sample.key == key]
    assert run.summary["dropped"] == {"overflowed": 0}
    assert run.summary["recording"] == str(run.path)


def test_monitor_metrics_are_published_and_recorded(run: Run) -> None:
    errors = [decode(Number, payload).value for payload in run.in_file[ERROR.key()]]
    walls = [one.wall for one in read(run.path).messages() if one.sample.key == ERROR.key()]
    assert 15 <= len(errors) <= 10.0 * (walls[-1] - walls[0]) + 5  # while the fleet plays, even slowly
    assert max(errors) < 1e-6
    assert run.summary["published"] == {one.key: len(run.in_file[one.key]) for one in OWN}
    for one in OWN:
        arrived = Counter(sample.payload for sample in run.arrived if sample.key == one.key)
        assert arrived
        assert not arrived - Counter(run.in_file[one.key])
    reported = [decode(Diagnostics, one).statuses for one in run.in_file[DIAGNOSTICS.key()]]
    names = ["", *run.actor.fleet.mission.names]
    assert [[one.hardware_id for one in statuses] for statuses in reported] == len(reported) * [names]
    # unknown before the fleet plays, and while a position is late
    robot2 = [statuses[2].values for statuses in reported if statuses[0].message == "error 0.0000 m"]
    assert {values["error.robot1"] for values in robot2} == {"0.0000"}
    rates = [float(values["rate.odom"]) for values in robot2]
    assert median(rates) == pytest.approx(20.0, rel=0.1)  # in one of them a message may be late


def test_snapshots_have_formation_edges_and_robots(run: Run) -> None:
    live = [one for one in run.snapshots if one["formation_error"] is not None]
    assert len(live) >= 10
    last = live[-1]
    assert last["formation_error"] < 1e-6
    assert last["formation_error_true"] is not None
    assert (last["mode"], last["shape"]) == ("run", "hexagon")
    assert len(last["edges"]) == 9
    assert list(last["robots"]) == list(run.actor.fleet.mission.names)
    robot = last["robots"]["robot3"]
    assert (robot["state"], robot["reason"]) == ("run", "in formation control")
    assert (robot["speed"], robot["turn_rate"]) == (0.2, 0.1)
    assert (robot["speed_share"], robot["turn_share"]) == pytest.approx((0.2 / 1.5, 0.1 / 1.5), abs=1e-4)
    assert robot["heading_error"] == pytest.approx(-0.05, abs=1e-4)
    assert robot["error"] < 1e-6
    assert 0.0 <= robot["age"] < 0.25


def test_summary_reports_convergence_and_settling_time(run: Run) -> None:
    assert run.summary["converged"] is True
    assert run.summary["settling_time"] < 0.5
    assert run.summary["formation_error"] < 1e-6


def test_monitor_publishes_nothing_to_robots(run: Run) -> None:
    bus, stage = run.actor.bus, run.actor.stage
    of_robots = {key: n for key, n in bus.received.items() if key[:6] in {"robot1", "robot2"}}
    # only what the test itself sent
    assert of_robots == {key: n for key, n in bus.published.items() if key[:6] in {"robot1", "robot2"}}
    assert stage.received == stage.published


def test_monitor_logs_every_two_seconds_and_records_last_messages(tmp_path: Path) -> None:
    path, begun = tmp_path / "run.mcap", time.monotonic()
    with watching("--record", str(path)) as (child, actor):
        while not with_known_error(child.log.splitlines()):
            assert time.monotonic() < begun + PATIENCE
            actor.play(0.5)
        child.signal(signal.SIGTERM)  # at once: messages are in transit
        lasted = time.monotonic() - begun
        summary = child.event("summary")
        lines = [line for line in child.errors.splitlines() if "error" in line]
    assert summary["received"] == actor.bus.published
    assert not actor.published - Counter(summary["recorded"])
    assert {key: len(payloads) for key, payloads in recorded(path).items()} == summary["recorded"]
    assert 2 <= len(lines) <= 1 + lasted / 2.0
    assert "error 0.0 mm" in with_known_error(lines)[-1]
    assert "6 run" in with_known_error(lines)[-1]


def with_known_error(lines: Sequence[str]) -> list[str]:
    """Return the lines with a known error; it is unknown while a position is late."""
    return [line for line in lines if "error " in line and "error unknown" not in line]


def test_malformed_messages_are_counted_recorded_and_survived(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rubbish = [b"", b"\0", b"\xff" * 100, b"\0\1\0\0" + b"\xff" * 72]
    with watching("--record", str(path), "--snapshots") as (child, actor):
        actor.play(0.5)
        for payload in rubbish:
            for one in KEYS:
                actor.bus_of(one.key).publish(one.key, payload, b"\xff" * 10)
        actor.play(1.0)
        actor.wait_until_recorded(path)
        child.signal(signal.SIGTERM)
        snapshots, summary = events(child)
    read_as_bytes = sum(one.topic.name == "scan" for one in KEYS)
    assert sum(summary["dropped"].values()) == len(rubbish) * (len(KEYS) - read_as_bytes)
    assert summary["recorded"][ODOM.key("robot2")] == 30 + len(rubbish)
    assert sum(snapshots[-1]["rejected"].values()) == sum(summary["rejected"].values())
    assert summary["formation_error"] < 1e-6


def test_ground_truth_is_unknown_without_simulated_robots() -> None:
    end = free_endpoint()
    flags = ("six_robots", "-e", end, "--no-record", "--no-page", "--snapshots")
    with (
        Bus(BusConfig(listen=(end,))) as bus,
        started("formation.monitor", *flags) as looking,
        started("formation.monitor", *flags, "--no-stage") as other,
    ):
        for child in (looking, other):
            child.event("ready")
        actor = Actor(bus, bus)
        until(lambda: len(inspect(end).links) == 2)
        until(lambda: all(bus.watched(STATUS.key(name)) for name in actor.fleet.mission.names))
        assert not bus.watched(GROUND_TRUTH.key("robot2"))  # agents do not know the ground truth
        actor.play(1.0)
        for child in (looking, other):
            child.signal(signal.SIGTERM)
            snapshots, summary = events(child)
            assert child.errors.splitlines() == [child.errors.strip()]
            assert "stopping" in child.errors
            assert (snapshots[-1]["formation_error_true"], snapshots[-1]["missed"]) == (None, 0)
            assert summary["formation_error"] < 1e-6
            assert summary["rejected"] == summary["robot"]["received"] == {}


def test_ros_flag_publishes_metrics_as_ros_2_topics(run: Run) -> None:
    published = run.summary["robot"]["published"]
    assert set(published) == {one.key for one in OWN}
    # Zenoh sends nothing before it knows of a listener: the first may be missing, every later one arrives.
    for one in OWN:
        arrived = [sample for sample in run.in_ros if sample.key == ROS.wire(one.key)]
        assert [sample.payload for sample in arrived] == run.in_file[one.key][-len(arrived) :]
        assert {len(sample.attachment or b"") for sample in arrived} == {33}
        assert len(arrived) <= published[one.key] <= len(run.in_file[one.key])
    errors = [sample for sample in run.in_ros if sample.key == ROS.wire(ERROR.key())]
    assert len(errors) >= 10


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--stage", "nonsense"), "--stage 'nonsense': must be PROTOCOL/HOST:PORT"),
        (("--stage", "robot9=tcp/desk:7"), "'robot9' must be a follower of six-robots: robot2"),
        (("--ros", "tcp/desk"), "--ros 'tcp/desk': must be PROTOCOL/HOST:PORT"),
        (("--ros-names", "rmw_zenoh"), "--ros ENDPOINT"),
        (("--no-page", "--control"), "--control: needs the page; leave out --no-page"),
        (("--control-config", "o.json5"), "--control-config FILE: needs --control"),
        (("--page", "192.0.2.1:8460"), "--page 192.0.2.1:8460: Cannot assign requested address"),
    ],
)
def test_invalid_flags_are_refused_and_leave_no_recording(
    flags: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in refused(capsys, "six_robots", "--record", str(tmp_path / "run.mcap"), *flags)
    assert not list(tmp_path.iterdir())


def test_existing_recording_or_invalid_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "dear.mcap").write_text("dear")
    for record in (tmp_path / "dear.mcap", tmp_path / "dear.mcap" / "run.mcap"):
        flags = ("-l", free_endpoint(), "--no-page", "--record", str(record))
        assert refused(capsys, "six_robots", *flags).startswith(f"monitor: --record {record}: ")
    assert (tmp_path / "dear.mcap").read_text() == "dear"


def test_missing_mission_is_refused_and_leaves_no_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "seven_robots" in refused(capsys, "seven_robots", "--record", str(tmp_path / "run.mcap"))
    assert not list(tmp_path.iterdir())


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the only line that the monitor prints when it refuses its arguments."""
    assert main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.count("\n") == 1
    return printed.err
