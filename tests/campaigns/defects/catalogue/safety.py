"""Defects of the failsafe table, the operator's latch and the watchdog."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

TABLE, STOPS, WATCHDOG = "agent/safety/failsafe.py", "formation/protocol/stops.py", "agent/watchdog/core.py"
LATCH, STATUS = "agent/safety/latch.py", "agent/status.py"

FIRST = ("stops", "robots")
"""Groups of plans that they meet first."""
DEFECTS = (
    Defect(
        "latched-stop-ignored", TABLE, 'f.latched == "stop",', 'f.latched == "stopped",', "a robot's own stop"
    ),
    Defect(
        "leader-stop-ignored",
        TABLE,
        'f.order is not None and f.order.mode == "stop",',
        'f.order is not None and f.order.mode == "halt",',
        "the stop in the leader's order",
    ),
    Defect(
        "lost-leader-tolerated",
        TABLE,
        """f.beat_silence > LEADER_TIMEOUT_SECONDS,
        AgentState.HOLD,
        lambda f: Reason.of(Code.LEADER_LOST""",
        """f.beat_silence > 1e3 * LEADER_TIMEOUT_SECONDS,
        AgentState.HOLD,
        lambda f: Reason.of(Code.LEADER_LOST""",
        "a robot follows a dead leader's last order",
    ),
    Defect(
        "own-silence-tolerated",
        TABLE,
        "lambda f: f.silence > f.limit,",
        "lambda f: f.silence > 50.0 * f.limit,",
        "a robot drives on without positions",
    ),
    Defect(
        "old-position-used",
        TABLE,
        "    Row(lambda f: f.too_old, AgentState.HOLD, _too_old, own=True),\n",
        "",
        "a robot acts on positions that are too old",
    ),
    Defect(
        "rival-ignored",
        TABLE,
        "    Row(lambda f: f.rival, AgentState.HOLD, _plain(Code.SECOND_AGENT), own=True),\n",
        "",
        "two agents drive one robot",
    ),
    Defect(
        "mixed-missions-ignored",
        TABLE,
        "    Row(lambda f: bool(f.other_missions), AgentState.HOLD, _mixed, own=True),\n",
        "",
        "robots of two missions drive together",
    ),
    Defect(
        "motion-doubt-ignored",
        TABLE,
        "    Row(lambda f: f.motion is not None, AgentState.HOLD, _motion, own=True, probes=True),\n",
        "",
        "a robot drives though it does not move as commanded",
    ),
    Defect(
        "release-starts",
        STOPS,
        'self.stop, self.hold = "", fact',
        'self.stop = ""',
        "ending a stop starts motion",
    ),
    Defect(
        "release-names-hold",
        STOPS,
        "if self.stop not in request.ends:",
        "if self.hold not in request.ends:",
        "a stop cannot be released",
    ),
    Defect(
        "run-during-stop",
        STOPS,
        'if self.stop:\n            return Result(ok=False, code="stopped"',
        'if self.stop and self.hold:\n            return Result(ok=False, code="stopped"',
        "run is obeyed while stopped",
    ),
    Defect(
        "overtaken-obeyed",
        STOPS,
        "overtaken = request.age > 0.0 and received - request.age < self.rested + TRAVEL_TIME",
        "overtaken = request.age > 0.0 and received < self.rested",
        "a late run undoes a newer stop",
    ),
    Defect(
        "watchdog-never-fires",
        WATCHDOG,
        "return now.mono - self._received >= self.limit - TICK_TOLERANCE",
        "return now.mono - self._received >= 1e3 * self.limit - TICK_TOLERANCE",
        "a robot drives on when its agent dies",
    ),
    Defect(
        "watchdog-stays-silent",
        WATCHDOG,
        "self.state not in {WatchdogState.BRAKING, WatchdogState.PARKING}",
        "self.state is not WatchdogState.PARKING",
        "the watchdog notices and does not brake",
    ),
    Defect(
        "watchdog-deaf",
        WATCHDOG,
        "if event in {Event.ALIVE, Event.FAREWELL} or self.state",
        "if event is Event.FAREWELL or self.state",
        "the watchdog brakes a robot with a healthy agent",
    ),
)
