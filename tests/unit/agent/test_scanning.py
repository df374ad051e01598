"""Robots with range scanners among posts, walls and other robots."""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Iterable, Sequence
from dataclasses import replace

import pytest

from formation.agent.core import Agent
from formation.control.unicycle import AT_REST
from formation.mission.file import load, parse
from formation.mission.model import Mission
from formation.mission.robot import Post, Wall
from formation.protocol.reasons import Code
from formation.protocol.status import AgentState
from formation.ros2.messages import LaserScan, decode
from formation.sensing.scan import Circle, Mate
from formation.stability.analysis import analyse
from formation.topics import SCAN
from formation.wire import Now, Sample
from tests.support.examples import slow
from tests.support.fleet import Fleet
from tests.support.meddling import altered, lost, on
from tests.support.missions import team
from tests.support.mutations import mutated
from tests.unit.agent.scanned import distance_to_wall

ALONE: dict[str, tuple[str, ...]] = {"robot1": ("leader",)}
IN_FILE = {"robot1": ("leader",), "robot2": ("leader",)}
"""robot2 starts 0.8 m behind robot1, and does not measure it."""
POST = Post(x=1.5, y=0.03, radius=0.1)
ACROSS = Wall(begin=(1.5, -3.0), end=(1.5, 3.0))
KEY = SCAN.key("robot1")


def among(mission: Mission, *things: Post | Wall) -> Mission:
    """The mission with these posts and walls."""
    posts = tuple(one for one in things if isinstance(one, Post))
    walls = tuple(one for one in things if isinstance(one, Wall))
    world = mission.simulation.model_copy(update={"posts": posts, "walls": walls})
    return mission.model_copy(update={"simulation": world})


def with_mode(mission: Mission, mode: str) -> Mission:
    collisions = mission.collisions.model_copy(update={"mode": mode})
    return mission.model_copy(update={"collisions": collisions})


def least_gap(fleet: Fleet, seconds: float) -> float:
    """Least gap between a follower and a post, a wall or another follower in that time [m]."""
    least = float("inf")
    posts = [post.disc for post in fleet.mission.simulation.posts]
    walls = [wall.line for wall in fleet.mission.simulation.walls]
    bodies = [(name, fleet.mission.robots[name].radius) for name in fleet.mission.followers]
    for _ in fleet.every(0.05, seconds):
        fleet.points()  # brings all robots up to now
        for number, (name, radius) in enumerate(bodies):
            here = fleet.plant(name).position
            others = [(fleet.plant(other).position, size) for other, size in bodies[:number]]
            gaps = [abs(at - here) - size for at, size in (*posts, *others)]
            gaps += [distance_to_wall(here, *wall) for wall in walls]
            least = min([least, *(gap - radius for gap in gaps)])
    return least


@pytest.mark.parametrize(
    "robot",
    [
        {},
        *slow({"odometry_frame": "start"}),
        {"measurement": "local"},
        *slow(
            {"localisation": "external"},
            {"localisation": "external", "heading": "measured"},
            {"avoid": "all", "scanner": "optional"},
        ),
    ],
    ids=["odometry", "start frame", "local", "external", "external, measured", "optional"],
)
def test_robot_drives_round_post_and_back_to_slot(robot: dict[str, str]) -> None:
    fleet = Fleet(among(team(ALONE, None, **{"scanner": "required", **robot}), POST))
    assert least_gap(fleet, 25.0) > 0.0
    assert fleet.plant("robot1").position.real > 3.0
    assert fleet.error() < 0.02


@pytest.mark.slow
def test_robot_without_scanner_hits_post() -> None:
    assert least_gap(Fleet(among(team(ALONE), POST)), 20.0) < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_six_robots_pass_posts_and_wall_and_reform(seed: int) -> None:
    mission = load("posts")
    fleet = Fleet(mission, seed=seed, loss=0.05)
    assert least_gap(fleet, mission.duration) > 0.0
    assert fleet.error() < mission.settled


@pytest.mark.parametrize(("mode", "law"), [*slow(("warn", "field")), ("off", "field"), ("on", "paper")])
def test_robot_stops_before_wall_without_collision_filter(mode: str, law: str) -> None:
    robot = {"scanner": "optional", "localisation": "external", "heading": "measured"}
    fleet = Fleet(with_mode(among(team(ALONE, None, **robot), ACROSS), mode), law=law)
    met = set()
    for _ in range(40):
        assert least_gap(fleet, 0.5) > 0.0
        met.add(fleet.status("robot1").zone)
    assert fleet.leader.where(fleet.now).real > 3.0
    assert {"clear", "stop"} <= met


def test_holding_robot_reports_zone_clear() -> None:
    fleet = Fleet(with_mode(among(team(ALONE, scanner="optional"), ACROSS), "off")).after(20.0)
    fleet.ask("leader", "hold")
    fleet.run(1.0)
    assert fleet.status("robot1").state == "hold"
    assert fleet.status("robot1").zone == "clear"


def test_robot_waits_for_first_required_scan() -> None:
    fleet = Fleet(team(ALONE, scanner="required"))
    fleet.meddle = lost(KEY)
    fleet.run(3.0)
    assert (fleet.status("robot1").state, fleet.status("robot1").reason.code) == ("waiting", Code.NO_SCAN)
    assert set(fleet.commands_since("robot1", 0.0)) == {AT_REST}


@pytest.mark.parametrize(("warm", "state"), [(0.0, "waiting"), (6.0, "hold")])
def test_refused_scans_are_named_instead_of_a_silence(warm: float, state: str) -> None:
    """The clock of the scanner's computer was never set, or its driver stamps every scan alike."""
    fleet = Fleet(team(ALONE, scanner="required")).after(warm)
    stamp = fleet.moment.wall - (0.0 if warm else 1e9)
    fleet.meddle = altered(KEY, LaserScan, lambda one: replace(one, stamp=stamp))
    fleet.run(2.5)
    status = fleet.status("robot1")
    assert (status.state, status.reason.code) == (state, Code.SCAN_REFUSED)
    assert "stamp" in str(status.reason)
    assert fleet.last_command("robot1") == AT_REST
    fleet.meddle = lost(KEY)
    fleet.run(2.0)
    assert fleet.status("robot1").reason.code is (Code.SCAN_SILENT if warm else Code.NO_SCAN)


def test_silent_required_scanner_holds_robot_until_it_returns() -> None:
    fleet = Fleet(team(ALONE, scanner="required")).after(6.0)
    fleet.meddle = lost(KEY)
    fell_silent = fleet.now
    fleet.run(2.0)
    result = fleet.status("robot1")
    assert result.state == "hold"
    assert result.reason.code is Code.SCAN_SILENT
    held = min(
        time for time, *command in fleet.commands["robot1"] if time > 6.0 and tuple(command) == AT_REST
    )
    assert held - fell_silent <= 3 / fleet.mission.robots["robot1"].scan.rate + 0.01
    fleet.meddle = lambda sample: (sample,)
    fleet.run(6.0)
    assert fleet.status("robot1").state == "run"
    assert fleet.error() < 0.01


def test_robot_continues_without_optional_scanner() -> None:
    fleet = Fleet(team(ALONE, scanner="optional")).after(6.0)
    fleet.meddle = lost(KEY)
    assert {fleet.status("robot1").state for _ in fleet.every(0.25, 3.0)} == {"run"}
    assert fleet.error() < 0.01


@pytest.mark.slow
def test_known_teammate_nearby_causes_no_avoiding() -> None:
    result = {}
    for avoid in ("all", ()):
        mission = team(IN_FILE, scanner="required", avoid=avoid)  # type: ignore[arg-type]
        near = {"row": {"robot1": (-0.8, 0.0), "robot2": (-1.3, 0.0)}}
        fleet = Fleet(mission.model_copy(update={"shapes": near}))
        fleet.run(15.0)
        result[avoid] = fleet.error() < 0.01, fleet.status("robot2").avoiding
    assert result == {"all": (True, False), (): (False, True)}


def test_post_is_no_teammate_while_heading_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    """robot2 assumes that it faces robot1; in fact it faces a post at the same distance."""
    mission = team(IN_FILE, scanner="required", avoid="all")
    robots = dict(mission.robots)
    turned = robots["robot2"].start.model_copy(update={"heading_deg": 90.0})
    robots["robot2"] = robots["robot2"].model_copy(update={"start": turned})
    ahead = Post(x=turned.x, y=turned.y + 0.8, radius=0.1)
    fleet = Fleet(among(mission.model_copy(update={"robots": robots}), ahead))
    seen: list[int] = []
    look = fleet.agents["robot2"].avoiding.scanner
    assert look is not None
    strangers = look.strangers

    def noted(now: Now, mates: Sequence[Mate]) -> list[Circle]:
        seen.append(len(mates))
        return strangers(now, mates)

    monkeypatch.setattr(look, "strangers", noted)
    fleet.run(6.0)
    assert seen[0] == 0
    assert seen[-1] == 1
    assert least_gap(fleet, 10.0) > 0.0


@pytest.mark.parametrize("when", [*slow(0.0), 6.0], ids=["at start", "while driving"])
def test_silent_teammate_seen_by_scanner_is_passed(when: float) -> None:
    mission = team(IN_FILE, scanner="required", avoid="all")
    in_line = {"row": {"robot1": (-0.8, 0.0), "robot2": (-1.6, 0.0)}}
    fleet = Fleet(mission.model_copy(update={"shapes": in_line})).after(when)
    fleet.kill("robot1")
    fleet.world._hosted["robot1"].plant.obey(AT_REST)
    there = fleet.plant("robot1").position
    assert least_gap(fleet, 25.0) > 0.0
    assert fleet.plant("robot2").position.real > there.real + 1.0
    *_, last = fleet.points()
    assert abs(last - fleet.leader.where(fleet.now) + 1.6) < 0.02


def test_bad_scans_are_counted_and_change_no_command() -> None:
    """They are truncated, of a wrong length or increment, repeated, or another robot's."""
    mission = among(team(ALONE, scanner="required"), POST)
    spared, attacked = Fleet(mission), Fleet(mission)
    seen: list[Sample] = []
    sent = {KEY: 0, "elsewhere": 0}

    def bad(sample: Sample) -> Iterable[Sample]:
        seen.append(sample)
        whole, step = sample.payload, decode(LaserScan, sample.payload)
        at = whole.index(struct.pack("<f", step.angle_increment))
        count = whole.index(len(step.ranges).to_bytes(4, "little"))
        payloads = [
            whole[:-9],
            whole[:count] + (361).to_bytes(4, "little") + whole[count + 4 :],
            whole[:at] + struct.pack("<f", math.nan) + whole[at + 4 :],
            whole[:at] + struct.pack("<f", 0.0) + whole[at + 4 :],
            b"",
            *(one.payload for one in seen[-9:-1:4]),
        ]
        sent[KEY] += len(payloads)
        sent["elsewhere"] += 1
        stranger = sample._replace(key=SCAN.key("robot9"))
        return [*(sample._replace(payload=one) for one in payloads), stranger, sample, sample]

    attacked.meddle = on(KEY, bad)
    spared.run(15.0)
    attacked.run(14.99)
    sent[KEY] += len(seen)  # each came twice
    attacked.meddle = spared.meddle
    attacked.run(0.01)
    assert attacked.commands == spared.commands
    dropped = attacked.agents["robot1"].dropped
    assert {key: dropped[key] for key in sent} == sent
    assert attacked.agents["robot1"].decision.state is AgentState.RUN


@pytest.mark.slow
def test_garbled_scans_crash_nothing_and_keep_limits() -> None:
    dice = random.Random(4)
    fleet = Fleet(among(team(ALONE, scanner="required"), POST))
    fleet.meddle = on(
        KEY, lambda one: [*(one._replace(payload=mutated(dice, [one.payload])) for _ in range(40)), one]
    )  # fmt: skip
    fleet.run(20.0)
    assert fleet.agents["robot1"].dropped[KEY] > 1000
    assert fleet.within_limits


def test_agent_subscribes_to_scan_only_with_scanner() -> None:
    assert KEY in Agent(team(ALONE, scanner="optional"), "robot1", "paper").subscriptions
    assert KEY not in Agent(team(ALONE), "robot1").subscriptions


TOWER = "seen = { radius = 0.035, x = -0.032 }"


def facing(*, mode: str, passes: bool, seen: str = TOWER) -> Mission:
    """Two Burgers that do not receive each other's positions; one drives towards the front of the other.

    If it `passes`, both change sides; otherwise the other stands in front of the slot.
    """
    slot, start = ("[1.0, 0.0]", -1.0) if passes else ("[0.05, 0.0]", 0.0)
    return parse(
        f"""
        name = "facing"
        leader = "leader"
        [law]
        k_p = 2.0
        k_i = 0.2
        [robot]
        control_point_offset = 0.05
        max_speed = 0.2108
        max_turn_rate = 2.635
        radius = 0.105
        rate = 20
        scanner = "required"
        scan = {{ rate = 5, x = -0.032, margin = 0.05 }}
        {seen}
        [simulated_robot]
        profile = "turtlebot3_burger"
        [collisions]
        lag = 0.1
        mode = "{mode}"
        [shapes.swapped]
        robot1 = [-1.0, 0.0]
        robot2 = {slot}
        [[route]]
        speed = 0.0
        heading_deg = 0
        [robots.leader]
        start = {{ x = 0.0, y = 3.0 }}
        [robots.robot1]
        neighbours = ["leader"]
        start = {{ x = 1.0, y = 3.0, heading_deg = 180 }}
        [robots.robot2]
        neighbours = ["leader"]
        start = {{ x = {start}, y = 3.0, heading_deg = 0 }}
        """
    )


@pytest.mark.slow
def test_robots_pass_bodies_wider_than_seen_part() -> None:
    fleet = Fleet(facing(mode="on", passes=True))
    assert least_gap(fleet, 20.0) > 0.05
    assert fleet.error() < 0.03


@pytest.mark.parametrize(("seen", "most"), [(TOWER, 0.15), ("", 0.1)], ids=["tower", "body"])
def test_zone_stops_before_body_seen_in_part_or_whole(seen: str, most: float) -> None:
    fleet = Fleet(facing(mode="off", passes=False, seen=seen))
    assert 0.04 < least_gap(fleet, 10.0) < most
    assert not seen or fleet.status("robot1").zone == "stop"


@pytest.mark.parametrize(("seen", "warns"), [("", True), (TOWER, False)])
def test_check_warns_if_burgers_have_no_seen_radius(seen: str, *, warns: bool) -> None:
    warnings = analyse(facing(mode="on", passes=True, seen=seen)).warnings
    assert any("seen = { radius = 0.035" in one for one in warnings) == warns
