"""Messages of simulated robots, and the command-line flags that choose their world."""

from __future__ import annotations

import argparse
import cmath
import itertools
import os
import random
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from formation.agent.simulated import __main__ as robots
from formation.agent.simulated.faults import Fault, with_faults
from formation.agent.simulated.flags import add_world_flags, unfit, world_flags
from formation.agent.simulated.simulated import World, kinematic
from formation.control.unicycle import control_point
from formation.mission.file import load
from formation.mission.model import Mission
from formation.ros2.messages import Displacement, Odometry, Pose, Twist, TwistStamped, decode, encode
from formation.wire import Outgoing, Sample
from tests.support.fleet import EPOCH, at
from tests.support.missions import with_robots
from tests.support.mutations import mutated

SIX = load("six_robots")


def twist(robot: str, arrived: float, speed: float, turn_rate: float = 0.0) -> Sample:
    return Sample(f"{robot}/cmd_vel", encode(Twist(speed, turn_rate)), None, arrived)


def leader_at(stamp: float, where: complex) -> Sample:
    return Sample("robot1/position", encode(Pose(EPOCH + stamp, where, 1 + 0j)), None, stamp)


def last(outbox: Iterable[Outgoing], key: str, kind: Any) -> Any:
    return decode(kind, [out.payload for out in outbox if out.key == key][-1])


def run(world: World, until: float, step: float = 0.05, inbox: Iterable[Sample] = ()) -> list[Outgoing]:
    """All that the world sends from 0 to `until`; commands come with the first step after they arrive."""
    waiting, outbox = sorted(inbox, key=lambda sample: sample.arrived), []
    for i in range(round(until / step) + 1):
        due = [sample for sample in waiting if sample.arrived <= i * step]
        waiting = waiting[len(due) :]
        outbox += world.step(at(i * step), due)
    return outbox


def odometry(outbox: Iterable[Outgoing]) -> list[Odometry]:
    """The odometry messages of robot2."""
    return [decode(Odometry, out.payload) for out in outbox if out.key == "robot2/odom"]


def faulty(kind: str, size: float, lasts: float = 1e9) -> World:
    """A world in which odometry of robot2 has this fault from 1 s on."""
    plants = with_faults(kinematic, [Fault("robot2", kind, size, since=1.0, lasts=lasts)])
    return World(SIX, ["robot2"], plants=plants)


@pytest.fixture
def local() -> Mission:
    return with_robots("six_robots", measurement="local")


def test_robots_publish_odometry_and_ground_truth_at_rate() -> None:
    world = World(SIX)
    keys = [out.key for out in run(world, 9.999, step=0.001)]
    assert set(keys) == {key for _, key in world.publications}
    assert {keys.count(key) for key in set(keys)} == {200}
    assert len(keys) == 200 * 2 * 5


@pytest.mark.parametrize(
    ("kind", "until", "stamp"),
    [
        ("stale", 1.9, 0.95),
        ("stale", 2.5, 1.5),
        ("backlog", 2.9, 1.9),
        ("stale", 4.05, 4.05),
        ("restamped", 3.9, 3.9),
    ],
)
def test_stamp_of_late_odometry_depends_on_fault(kind: str, until: float, stamp: float) -> None:
    found = last(run(faulty(kind, 1.0, lasts=3.0), until), "robot2/odom", Odometry)
    assert found.stamp - EPOCH == pytest.approx(stamp, abs=0.051)


def test_stale_odometry_is_overtaken_but_not_lost() -> None:
    stamps = [one.stamp for one in odometry(run(faulty("stale", 1.0, lasts=3.0), 6.0))]
    assert len(set(stamps)) == len(stamps) == 121, "no message is lost or repeated"
    assert sorted(stamps) != stamps


def test_robots_publish_at_different_times() -> None:
    world = World(SIX)
    result = [{out.key.split("/")[0] for out in world.step(at(i * 0.01), [])} for i in range(10)]
    assert [len(robots) for robots in result] == [1] * 10


def test_robots_start_at_rest_at_their_start_poses() -> None:
    mission = SIX
    outbox = run(World(mission), 1.0)
    for name in mission.followers:
        odometry = last(outbox, f"{name}/odom", Odometry)
        start = mission.robots[name].start
        assert (odometry.position, odometry.speed, odometry.turn_rate) == (start.position, 0.0, 0.0)
        assert odometry.heading == pytest.approx(start.heading)


def test_command_takes_effect_on_arrival_for_any_step() -> None:
    mission, ends = SIX, []
    commands = [twist("robot2", 0.513, 0.4), twist("robot2", 1.377, 0.2, 1.0), twist("robot2", 2.001, 0.0)]
    for step in (0.001, 0.05, 0.4):
        world = World(mission)
        run(world, 4.0, step, commands)
        ends.append((world.plant("robot2").position, world.plant("robot2").heading))
    for position, heading in ends[1:]:
        assert position == pytest.approx(ends[0][0], abs=1e-9)
        assert heading == pytest.approx(ends[0][1], abs=1e-9)
    start = mission.robots["robot2"].start
    assert abs(ends[0][0] - start.position) == pytest.approx(
        abs(0.4 * 0.864 * 1j + 0.2 * (cmath.exp(0.624j) - 1)), abs=1e-6
    )


def test_last_command_stays_in_force_without_messages() -> None:
    world = World(SIX, ["robot2"])
    run(world, 0.0, inbox=[twist("robot2", 0.0, 0.1)])
    world.step(at(3600.0), [])
    assert abs(world.plant("robot2").position - (-1.5 + 2.0j)) == pytest.approx(360.0)


def test_odometry_and_ground_truth_match_their_stamp() -> None:
    world = World(SIX, ["robot2"])
    run(world, 1.0, inbox=[twist("robot2", 0.0, 0.1)])
    outbox = world.step(at(1.237), [])
    odometry, truth = last(outbox, "robot2/odom", Odometry), last(outbox, "robot2/ground_truth", Pose)
    assert odometry.stamp == truth.stamp == pytest.approx(EPOCH + 1.237, abs=1e-6)
    assert truth.position == pytest.approx(-1.5 + 2.0j + 0.1237j)
    assert odometry.speed == 0.1


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\x00\x01\x00\x00",
        encode(Twist(1.0, 1.0))[:-9],
        encode(TwistStamped(EPOCH, 1.0, 1.0)),
        encode(Twist(1.0, 1.0)).replace(b"\xf0\x3f", b"\xf8\x7f"),  # NaN for 1.0
        encode(Twist(1.0, 1.0)).replace(b"\xf0\x3f", b"\xf0\x7f"),  # infinity for 1.0
    ],
)
def test_invalid_command_is_dropped_and_counted(payload: bytes) -> None:
    world = World(SIX)
    run(world, 1.0, inbox=[twist("robot2", 0.5, 0.1), Sample("robot2/cmd_vel", payload, None, 0.6)])
    assert world.plant("robot2").command == (0.1, 0.0)
    assert world.dropped == {"robot2/cmd_vel": 1}


def test_robot_with_stamped_twists_ignores_plain_twists() -> None:
    world = World(load("turtlebot3_pair"))
    stamped = Sample("robot2/cmd_vel", encode(TwistStamped(EPOCH, 0.1, 0.0)), None, 0.0)
    run(world, 0.1, inbox=[twist("robot1", 0.0, 0.1), stamped])
    assert world.plant("robot1").command == (0.0, 0.0)
    assert world.plant("robot2").command == (0.1, 0.0)
    assert world.dropped == {"robot1/cmd_vel": 1}


def test_mutated_commands_never_exceed_robot_limits() -> None:
    world, chance = World(load("turtlebot3_pair"), ["robot1"]), random.Random(1)
    whole = encode(TwistStamped(EPOCH, 0.1, 0.5))
    for i in range(2_000):
        world.step(at(i * 0.01), [Sample("robot1/cmd_vel", mutated(chance, [whole]), None, i * 0.01)])
        plant = world.plant("robot1")
        assert abs(plant.command.speed) <= 0.2108
        assert abs(plant.command.turn_rate) <= 2.635
    assert cmath.isfinite(world.plant("robot1").position)
    assert 0 < world.dropped["robot1/cmd_vel"] < 2_000


def test_noise_is_independent_of_other_hosted_robots() -> None:
    mission = load("turtlebot3_pair")
    both, alone = run(World(mission, seed=5), 2.0), run(World(mission, ["robot2"], seed=5), 2.0)
    apart = run(World(mission, ["robot2"], seed=6), 2.0)

    def path(outbox: list[Outgoing]) -> list[complex]:
        return [one.position for one in odometry(outbox)]

    assert path(both)[:30] == path(alone)[:30]
    assert path(alone) != path(apart)


def test_local_sensor_measures_displacement_in_its_own_frame(local: Mission) -> None:
    world = World(local)
    commands = [twist("robot2", 0.0, 0.3, 0.5), twist("robot3", 0.0, 0.2, -0.7)]
    run(world, 3.0, 0.01, commands)
    outbox = [out for i in range(6) for out in world.step(at(3.01 + i * 0.01), [])]
    result = last(outbox, "robot3/relative/robot2", Displacement)
    truth = last(outbox, "robot3/ground_truth", Pose)
    assert result.stamp == truth.stamp
    other = World(local)
    run(other, result.stamp - EPOCH, 0.01, commands)
    other.step(at(result.stamp - EPOCH), [])
    points = {}
    for name in ("robot2", "robot3"):
        other._hosted[name].go_to(result.stamp - EPOCH)
        points[name] = control_point(other.plant(name).position, other.plant(name).heading, 0.2)
    expected = (points["robot2"] - points["robot3"]) * truth.heading.conjugate()
    assert result.displacement == pytest.approx(expected, abs=1e-6)


def test_sensor_message_precedes_odometry(local: Mission) -> None:
    world = World(local, ["robot2", "robot3"])
    keys = [out.key for out in run(world, 0.0, inbox=[leader_at(0.0, 0j)])]
    keys += [out.key for out in world.step(at(0.025), [])]
    assert keys == [
        "robot2/relative/robot1", "robot2/odom", "robot2/ground_truth",
        "robot3/relative/robot1", "robot3/relative/robot2", "robot3/odom", "robot3/ground_truth",
    ]  # fmt: skip


def test_sensor_extrapolates_position_of_virtual_leader(local: Mission) -> None:
    world = World(local, ["robot2"])
    positions = [leader_at(i * 0.05, 0.2 * i * 0.05 + 0j) for i in range(40)]  # the last at 1.95 s
    run(world, 1.99, 0.01, positions)
    outbox = world.step(at(2.0), [])
    result = last(outbox, "robot2/relative/robot1", Displacement)
    truth = last(outbox, "robot2/ground_truth", Pose)
    mine = control_point(truth.position, truth.heading, 0.2)
    assert result.displacement * truth.heading == pytest.approx(0.4 - mine, abs=1e-6)


def test_silent_leader_is_not_measured(local: Mission) -> None:
    world = World(local, ["robot2"])
    assert "robot1/position" in world.subscriptions
    assert "robot1/position" not in World(SIX).subscriptions
    assert not [out for out in run(world, 1.0) if "relative" in out.key]
    world.step(at(1.0), [leader_at(1.0, 0j)])
    assert [out for out in world.step(at(1.1), []) if "relative" in out.key]
    assert not [out for out in world.step(at(1.6), []) if "relative" in out.key]


def test_leader_position_with_wrong_stamp_is_dropped(local: Mission) -> None:
    world = World(local, ["robot2"])
    world.step(at(1.0), [leader_at(1.0, 0j)])
    world.step(at(1.1), [leader_at(9e5, 5 + 0j), leader_at(1.0, 5 + 0j), leader_at(0.2, 5 + 0j)])
    assert world.dropped == {"robot1/position": 3}
    assert abs(last(world.step(at(1.2), []), "robot2/relative/robot1", Displacement).displacement) < 3.0


def test_measured_robot_must_be_in_same_process(local: Mission) -> None:
    with pytest.raises(ValueError, match="'robot3' measures 'robot2' with a sensor"):
        World(local, ["robot3", "robot4"])


def test_only_followers_can_be_simulated() -> None:
    for name in ("robot1", "robot9"):
        with pytest.raises(ValueError, match=f"'{name}': must be a follower of six-robots: robot2, robot3"):
            World(SIX, [name])


def test_stuttering_odometry_comes_in_bursts() -> None:
    stamps = [one.stamp for one in odometry(run(faulty("stutter", 0.5), 5.0))]
    assert len(stamps) == pytest.approx(60, abs=2)
    assert max(after - before for before, after in itertools.pairwise(stamps)) == pytest.approx(0.5, abs=0.06)


def read(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_world_flags(parser)
    return parser.parse_args(words)


def test_world_flags_are_empty_by_default() -> None:
    assert world_flags(read()) == ()
    assert unfit(read(), SIX) is None


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("robot3:stale=2@1+2", None),
        ("robot9:stale@1", "'robot9:stale@1': robot9: must be one of robot2, robot3, robot4, robot5, robot6"),
        ("robot1:stale@1", "'robot1:stale@1': robot1: must be one of robot2, robot3, robot4, robot5, robot6"),
        (
            "robot3:scan_late@1",
            "'robot3:scan_late@1': robot3 has no sensor for scan_late; no robot of the mission has one",
        ),
        ("robot3:blocked=3@1", "'robot3:blocked=3@1': blocked takes no SIZE"),
        ("robot3:stale=nan@1", "'robot3:stale=nan@1': SIZE must be from 0 to 60 s"),
        ("robot3:speeds=20@1", "'robot3:speeds=20@1': SIZE must be from -10 to 10"),
        ("robot3:stale=x@1", "'robot3:stale=x@1': SIZE, START and SECONDS must be numbers without units"),
    ],
)
def test_faults_are_checked_against_the_mission(fault: str, says: str | None) -> None:
    assert unfit(read("--fault", fault), SIX) == (None if says is None else f"--fault {says}")


def test_world_flags_are_passed_on_unchanged(tmp_path: Path) -> None:
    words = ("--world", "mujoco", "--picture", str(tmp_path / "end.png"))
    assert world_flags(read(*words)) == words


def test_picture_needs_physics_world_and_gets_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    assert unfit(read("--picture", "end.png"), SIX) == "--picture: needs --world mujoco"
    new = tmp_path / "new" / "folder" / "end.png"
    assert unfit(read("--world", "mujoco", "--picture", str(new)), SIX) is None
    assert new.parent.is_dir()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("mission.toml", "must end in .png"),
        ("end.jpg", "must end in .png"),
        ("folder.png", "is a folder; name a file"),
        ("text.png", "is there already, and is no picture; name another file"),
        ("pipe.png", "is there already, and is no picture; name another file"),
        (f"{'long' * 75}.png", "File name too long"),
        ("old.png", None),
        ("nothing.PNG", None),
        ("new.png", None),
    ],
)
def test_picture_replaces_only_an_older_picture(
    name: str, says: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    (tmp_path / "mission.toml").write_text("precious")
    (tmp_path / "text.png").write_text("precious")
    (tmp_path / "old.png").write_bytes(b"\x89PNG\r\n\x1a\n and so on")
    (tmp_path / "nothing.PNG").touch()
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    picture = str(tmp_path / name)
    wrong = unfit(read("--world", "mujoco", "--picture", picture), SIX)
    assert wrong == (None if says is None else f"--picture {picture}: {says}")


def test_picture_without_egl_names_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr("formation.agent.simulated.flags.find_library", lambda _: None)
    assert "apt install libegl1" in str(unfit(read("--world", "mujoco", "--picture", "end.png"), SIX))


def test_missing_physics_extra_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(robots, "find_spec", lambda _: None)
    assert robots.main(["six_robots", "--world", "mujoco"]) == 2
    result = capsys.readouterr().err
    assert result.count("\n") == 1
    assert "pip install '.[physics]'" in result


def test_physics_world_refuses_robot_flag(capsys: pytest.CaptureFixture[str]) -> None:
    assert robots.main(["six_robots", "--world", "mujoco", "--robot", "robot2"]) == 2
    assert "leave out --robot" in capsys.readouterr().err
