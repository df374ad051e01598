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

from formation.monitor.metrics.keys import OWN
from formation.monitor.recording.reader import read
from formation.ros2.messages import Diagnostics, Number, decode
from formation.ros2.naming import Naming
from formation.ros2.ros_names import Ros
from formation.topics import DIAGNOSTICS, ERROR, GROUND_TRUTH, ODOM, STATUS
from formation.transport.bus import Bus, BusConfig
from formation.wire import Sample
from tests.processes.agent.actor import KEYS, Actor, events, recorded, router, watching
from tests.support.child import PATIENCE, free_endpoint, started, until

pytestmark = pytest.mark.processes


class Run(NamedTuple):
    """Results of three seconds of a fleet in formation."""

    actor: Actor
    arrived: list[Sample]
    """What the fleet received from the monitor."""
    snapshots: list[dict[str, Any]]
    summary: dict[str, Any]
    path: Path
    in_file: dict[str, list[bytes]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    path = tmp_path_factory.mktemp("run") / "new" / "run.mcap"
    with watching("--record", str(path), "--snapshots") as (child, actor):
        for one in OWN:
            actor.bus.subscribe(one.key)
        actor.play(3.0)
        actor.wait_until_recorded(path)
        child.signal(signal.SIGTERM)
        snapshots, summary = events(child)
        assert child.wait() == 0
        return Run(actor, actor.bus.drain(), snapshots, summary, path, recorded(path))


@pytest.mark.smoke
def test_every_published_message_is_recorded_exactly(run: Run) -> None:
    published = run.actor.published
    assert sum(published.values()) == 60 * (6 + 3 * 5) + 6 * 6
    assert run.summary["received"] == run.actor.bus.published
    assert run.summary["robot"] == {"published": {}, "received": run.actor.stage.published}
    assert run.summary["recorded"] == published + Counter(run.summary["published"])
    assert run.summary["recorded"] == {key: len(payloads) for key, payloads in run.in_file.items()}
    for key in published:
        assert run.in_file[key] == [sample.payload for sample in run.actor.sent if sample.key == key]
    assert run.summary["dropped"] == {"overflowed": 0}
    assert run.summary["recording"] == str(run.path)


def test_messages_in_transit_at_the_end_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with watching("--record", str(path)) as (child, actor):
        actor.play(0.5)
        child.signal(signal.SIGTERM)  # at once
        summary = child.event("summary")
    assert summary["received"] == actor.bus.published
    assert not actor.published - Counter(summary["recorded"])
    assert {key: len(payloads) for key, payloads in recorded(path).items()} == summary["recorded"]


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


def test_monitor_without_snapshots_logs_every_two_seconds(tmp_path: Path) -> None:
    begun = time.monotonic()
    with watching("--record", str(tmp_path / "run.mcap")) as (child, actor):
        while not with_known_error(child.log.splitlines()):
            assert time.monotonic() < begun + PATIENCE
            actor.play(0.5)
        child.signal(signal.SIGTERM)
        lasted = time.monotonic() - begun
        child.event("summary")
        lines = [line for line in child.errors.splitlines() if "error" in line]
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


def test_monitor_publishes_nothing_to_robots(tmp_path: Path) -> None:
    with watching("--no-record", "--snapshots") as (child, actor):
        actor.bus.subscribe("robot2/**")
        actor.bus.subscribe("robot1/**")
        actor.stage.subscribe("**")
        actor.play(1.0)
        child.signal(signal.SIGTERM)
        # only what the test itself sent
        arrived = {key: n for key, n in actor.bus.published.items() if key[:6] in {"robot1", "robot2"}}
        assert actor.bus.received == arrived
        assert actor.stage.received == actor.stage.published
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("flags", [("--no-stage",), ()])
def test_ground_truth_is_unknown_without_simulated_robots(flags: tuple[str, ...]) -> None:
    end = free_endpoint()
    with (
        Bus(BusConfig(listen=(end,))) as bus,
        started(
            "formation.monitor", "six_robots", "-e", end, "--no-record", "--no-page", "--snapshots", *flags
        ) as child,
    ):
        child.event("ready")
        actor = Actor(bus, bus)
        until(lambda: all(bus.watched(STATUS.key(name)) for name in actor.fleet.mission.names))
        assert not bus.watched(GROUND_TRUTH.key("robot2"))  # agents do not know the ground truth
        actor.play(2.0)
        child.signal(signal.SIGTERM)
        snapshots, summary = events(child)
        assert child.errors.splitlines() == [child.errors.strip()]
        assert "stopping" in child.errors
    assert (snapshots[-1]["formation_error_true"], snapshots[-1]["missed"]) == (None, 0)
    assert summary["formation_error"] < 1e-6
    assert summary["rejected"] == summary["robot"]["received"] == {}


@pytest.mark.parametrize("names", ["ros2dds", "rmw_zenoh"])
def test_ros_flag_publishes_metrics_as_ros_2_topics(names: Ros, tmp_path: Path) -> None:
    end, path = free_endpoint(), tmp_path / "run.mcap"
    naming = Naming.of_formation(names, 7)
    wires = {one.key: naming.wire(one.key) for one in OWN}
    ros_flags = ("--ros", end, "--ros-names", names, "--ros-domain", "7")
    arrived: dict[str, list[bytes]] = {wire: [] for wire in wires.values()}
    with watching("--record", str(path), "--snapshots", *ros_flags) as (child, actor), router(end) as ros:
        ros.subscribe("**")  # the router starts after the monitor, which does not wait for it
        until(lambda: ros.received[wires[DIAGNOSTICS.key()]] > 0)  # without a fleet, no others are published
        actor.play(3.0)
        child.signal(signal.SIGTERM)
        _, summary = events(child)
        assert child.wait() == 0
        reported = {wires[one.key]: recorded(path)[one.key] for one in OWN}

        def all_received() -> bool:
            for sample in ros.drain():
                arrived[sample.key].append(sample.payload)
                assert len(sample.attachment or b"") == (0 if names == "ros2dds" else 33)
            return all(payloads[-1:] == reported[wire][-1:] for wire, payloads in arrived.items())

        until(all_received)
    # Zenoh sends nothing before it knows of a listener: the first may be missing, every later one arrives.
    for wire, payloads in arrived.items():
        assert payloads == reported[wire][-len(payloads) :]
    for one in OWN:
        wire = wires[one.key]
        assert len(arrived[wire]) <= summary["robot"]["published"][one.key] <= len(reported[wire])
    errors = [decode(Number, payload).value for payload in arrived[wires[ERROR.key()]]]
    assert len(errors) >= 10
    assert max(errors) < 1e-6


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--stage", "nonsense"), "--stage 'nonsense': must be PROTOCOL/HOST:PORT"),
        (("--stage", "robot9=tcp/desk:7"), "'robot9' must be a follower of six-robots: robot2"),
        (("--ros", "tcp/desk"), "--ros 'tcp/desk': must be PROTOCOL/HOST:PORT"),
        (("--ros-names", "rmw_zenoh"), "--ros ENDPOINT"),
    ],
)
def test_invalid_link_flags_are_refused_and_leave_no_recording(
    flags: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    with started("formation.monitor", "six_robots", "--record", str(tmp_path / "run.mcap"), *flags) as child:
        assert child.wait() == 2
        assert words in child.errors
        assert child.errors.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_existing_recording_or_invalid_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "dear.mcap").write_text("dear")
    for record in (tmp_path / "dear.mcap", tmp_path / "dear.mcap" / "run.mcap"):
        with started("formation.monitor", "six_robots", "--record", str(record)) as child:
            assert child.wait() == 2
            assert child.errors.startswith(f"monitor: --record {record}: ")
            assert child.errors.count("\n") == 1
    assert (tmp_path / "dear.mcap").read_text() == "dear"


def test_missing_mission_is_refused_and_leaves_no_recording(tmp_path: Path) -> None:
    with started("formation.monitor", "seven_robots", "--record", str(tmp_path / "run.mcap")) as child:
        assert child.wait() == 2
        assert "seven_robots" in child.errors
    assert not list(tmp_path.iterdir())
