"""Defects of the collision filter and the protective zones."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

MATHS, FILTER, PIPELINE = (
    "formation/control/avoidance.py",
    "agent/collision_filter.py",
    "formation/control/pipeline.py",
)
ZONES, SCANNER, SCAN = "formation/control/zones.py", "agent/safety/scanner.py", "formation/sensing/scan.py"

DEFECTS = (
    Defect(
        "half-plane-inverted",
        MATHS,
        "return HalfPlane(towards.real, towards.imag, max(most",
        "return HalfPlane(-towards.real, -towards.imag, max(most",
        "robots drive towards each other",
        ("crowd", "crossing"),
    ),
    Defect(
        "brake-dropped",
        MATHS,
        "done = brake(give_way(aim, obstacles, parameters, limits), obstacles, parameters)",
        "done = give_way(aim, obstacles, parameters, limits)",
        "the filter evades and does not brake",
        ("crowd", "crossing"),
    ),
    Defect(
        "both-radii-forgotten",
        MATHS,
        "(lever + parameters.radius + obstacle.radius + obstacle.unsure + parameters.margin)",
        "(obstacle.unsure + parameters.margin)",
        "the filter evades from centre to centre",
        ("crowd", "crossing"),
    ),
    Defect(
        "brake-late",
        MATHS,
        "most = max(0.0, 0.5 * room / (parameters.hold",
        "most = max(0.0, 5.0 * room / (parameters.hold",
        "the brake lets robots approach ten times as fast",
        ("crowd", "crossing"),
    ),
    Defect(
        "no-way-out",
        MATHS,
        "DEADLOCK_DELAY, DETOUR_TIME = 0.5, 1.5",
        "DEADLOCK_DELAY, DETOUR_TIME = 500.0, 1.5",
        "robots that block each other wait for ever",
        ("barred", "crowd", "crossing"),
    ),
    Defect(
        "nobody-yields",
        FILTER,
        "name: mission.has_right_of_way(name, robot) for name in avoided",
        "name: False for name in avoided",
        "every robot takes the right of way",
        ("crowd", "crossing"),
    ),
    Defect(
        "obstacles-in-world-frame",
        FILTER,
        "facing * (there.at - mine) +",
        "(there.at - mine) +",
        "the filter looks for others in a wrong direction",
        ("crowd", "crossing"),
    ),
    Defect(
        "silent-robots-forgotten",
        FILTER,
        "known = self._known(around)\n        obst",
        "known = {n: one for n, one in self._known(around).items() if one.fresh(now)}\n        obst",
        "a robot that has fallen silent is no obstacle",
        ("barred", "crowd", "crossing"),
    ),
    Defect(
        "filter-switched-around",
        PIPELINE,
        """clear if params.avoids else wanted, inputs, obstacles, params)
    after = ControlState(""",
        """wanted if params.avoids else clear, inputs, obstacles, params)
    after = ControlState(""",
        "the filter only watches",
        ("crowd", "crossing"),
    ),
    Defect(
        "zone-behind",
        ZONES,
        "else free((sign * point for point in seen), radius, right, left)",
        "else free((-sign * point for point in seen), radius, right, left)",
        "the protective zone lies behind the robot",
        ("posts",),
    ),
    Defect(
        "strangers-are-mates",
        SCAN,
        "MAX_TEAM_MATE_ERROR = 0.1",
        "MAX_TEAM_MATE_ERROR = 3.0",
        "posts near a robot are taken for that robot",
        ("posts",),
    ),
    Defect(
        "frozen-scan-unnoticed",
        SCANNER,
        "if moved and known.beams >= MIN_EQUAL_BEAMS and",
        "if moved and known.beams < MIN_EQUAL_BEAMS and",
        "a scanner that repeats one scan is believed",
        ("posts",),
    ),
)
