"""Defects of what an agent believes of its sensors and of others' positions."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

STREAM, LATENESS, CHECK = (
    "agent/pose/stream.py",
    "formation/protocol/lateness.py",
    "agent/pose/motion_check.py",
)
PROBE, SOURCES, ESTIMATOR = "agent/pose/probe.py", "agent/pose/sources.py", "agent/pose/estimator.py"
RELATIVE, NEIGHBOURS = "agent/following/relative_check.py", "agent/following/neighbours.py"

DEFECTS = (
    Defect(
        "always-fresh",
        STREAM,
        "not state.doubted and now.mono - state.arrived <= self.limit",
        "not state.doubted and now.mono - state.arrived <= 60.0 * self.limit",
        "neighbours that are silent are followed on",
        ("crashed", "robotcut", "muted"),
    ),
    Defect(
        "replayed-stamps-accepted",
        STREAM,
        "return by_stamp > 0.0 and abs(by_stamp - by_arrival) <= self.longest_delay",
        "return abs(by_stamp - by_arrival) <= 1e3 * self.longest_delay",
        "messages out of order count",
        ("twice",),
    ),
    Defect(
        "late-messages-accepted",
        STREAM,
        "if stamp <= state.stamp or late <= self.longest_delay:",
        "if stamp <= state.stamp or late <= 1e3 * self.longest_delay:",
        "positions that get later and later count",
        ("leaderlate", "late"),
    ),
    Defect(
        "clock-unit",
        STREAM,
        "MAX_STAMP_OFFSET = 86_400.0",
        "MAX_STAMP_OFFSET = 24.0",
        "a robot whose clock is half a minute off is refused",
        ("clocks",),
    ),
    Defect(
        "age-ignored",
        STREAM,
        "return self.state.late if refused else max(self.state.late, self.state.delay)",
        "return 0.0 if refused else min(self.state.late, 0.0)",
        "old positions of its own count as new",
        ("late",),
    ),
    Defect(
        "trust-never-regained",
        LATENESS,
        "since = min(before.since, moment)",
        "since = moment",
        "a robot whose positions were late never drives again",
        ("late",),
    ),
    Defect(
        "frozen-unnoticed",
        CHECK,
        "POSITION = Tolerance(net_min=0.06, still_min=0.035,",
        "POSITION = Tolerance(net_min=6.0, still_min=3.5,",
        "a frozen position is believed for metres",
        ("frozen",),
    ),
    Defect(
        "carried-unnoticed",
        CHECK,
        "if seen > MAX_MOTION_RATIO * most + limits.carried:",
        "if seen > 1e3 * MAX_MOTION_RATIO * most + 1e3 * limits.carried:",
        "a robot that is carried away drives on",
        ("carried",),
    ),
    Defect(
        "speeds-unchecked",
        CHECK,
        "if abs(by_speeds - by_positions) > (1.0 - MIN_MOTION_SHARE) * most + 0.5 * changed:",
        "if abs(by_speeds - by_positions) > 2.0 * most + 0.5 * changed:",
        "wrong speeds of odometry are believed",
        ("speeds",),
    ),
    Defect(
        "lateness-unchecked",
        CHECK,
        "            if delay is not None:\n",
        "            if delay is not None and delay > 1e3 * limit:\n",
        "positions without true stamps may be late",
        ("restamped",),
    ),
    Defect(
        "probe-at-full-speed",
        PROBE,
        "self._speed = max(PROBE_SPEED_SHARE * limits.max_speed, steps.speed)",
        "self._speed = max(limits.max_speed, steps.speed)",
        "a robot that is in doubt drives at full speed",
        ("frozen",),
    ),
    Defect(
        "probe-verdict-inverted",
        PROBE,
        "self._seen(doubt, speeds=speeds) and self._delay(doubt) <= limit",
        "not self._seen(doubt, speeds=speeds) and self._delay(doubt) <= limit",
        "a robot goes on exactly if it did not move",
        ("frozen",),
    ),
    Defect(
        "displacement-not-turned",
        NEIGHBOURS,
        "self._see(me + heading * self.state.displacement, elapsed)",
        "self._see(me + self.state.displacement, elapsed)",
        "what a sensor measures is taken for the world frame",
        ("quiet",),
    ),
    Defect(
        "sensor-doubt-dropped",
        NEIGHBOURS,
        "return self.check.state.doubt\n",
        "return None\n",
        "a frozen sensor of neighbours is believed",
        ("relative",),
    ),
)
