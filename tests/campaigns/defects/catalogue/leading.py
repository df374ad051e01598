"""Defects of the leader: its plan, its route, its orders, its operator."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

PLAN, CORE, COHESION, REPORTS = "leader/plan.py", "leader/core.py", "leader/cohesion.py", "leader/reports.py"
INTENT, ROUTE, SHAPE = (
    "formation/stability/intent.py",
    "formation/mission/route.py",
    "leader/shape_transition.py",
)
FENCE, PLACED = "formation/slots/geofence.py", "formation/slots/shape.py"

DEFECTS = (
    Defect(
        "rotation-in-degrees",
        INTENT,
        "rotation=math.remainder(math.radians(request.degrees), math.tau)",
        "rotation=math.remainder(request.degrees, math.tau)",
        "a shape turns by another angle than ordered",
        ("orders",),
    ),
    Defect(
        "route-time-lost",
        PLAN,
        "self.route_time, self.team_mode.lost, self.fenced = order.time, None, None",
        "self.route_time, self.team_mode.lost, self.fenced = 0.0, None, None",
        "a new leader begins the route again",
        ("ordersfailover", "killed"),
    ),
    Defect(
        "stop-not-inherited",
        PLAN,
        'self.rest.stop = self.rest.stop or f"term-{order.term}"',
        'self.rest.stop = self.rest.stop or ""',
        "a new leader does not know of the stop",
        ("leaderstop", "power"),
    ),
    Defect(
        "shape-not-inherited",
        PLAN,
        "wish = Wish(order.shape, order.rotation, order.scale)",
        "wish = Wish(self._mission.first_shape, 0.0, 1.0)",
        "a new leader forgets which shape is ordered",
        ("ordersfailover",),
    ),
    Defect(
        "fence-ignored",
        PLAN,
        "        self.fenced = self._fenced(dt)\n",
        "",
        "the leader leads its team out of the bounds",
        ("fenced",),
    ),
    Defect(
        "drives-while-held",
        PLAN,
        'if mode != "run":\n            self.shape_transition.rest()\n            return',
        'if mode == "":\n            self.shape_transition.rest()\n            return',
        "the leader drives away while its team stands",
        ("rests", "fenced"),
    ),
    Defect(
        "patience-inverted",
        COHESION,
        "if mono - since > patience}",
        "if mono - since < patience}",
        "the leader waits for ever",
        ("blocked", "robotstall", "killed"),
    ),
    Defect(
        "stamp-of-wrong-clock",
        CORE,
        "pose = Pose(now.wall, self.plan.where(),",
        "pose = Pose(now.mono, self.plan.where(),",
        "the leader's positions are refused",
        ("quiet",),
    ),
    Defect(
        "beat-stands-still",
        CORE,
        "return max(self.beat + (1 if changed or self.beat == 0 else 0), periods)",
        "return self.beat + (1 if changed or self.beat == 0 else 0)",
        "robots take their leader for dead",
        ("quiet", "slow"),
    ),
)
