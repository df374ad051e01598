"""Why some defects are not found, as it is supposed from the source: removing two at once would show it."""

from __future__ import annotations

from collections.abc import Mapping

SECOND = "another safeguard has the same effect: "
REASONS: Mapping[str, str] = {
    "own-silence-tolerated": f"{SECOND}without positions an agent sends no commands, and the watchdog brakes",
    "lost-leader-tolerated": f"{SECOND}a leader that is silent cannot be followed either",
    "run-during-stop": f"{SECOND}the stop stays in force; only the answer is wrong, which no rule reads",
    "overtaken-obeyed": f"{SECOND}a run and a release name what they end",
    "earlier-term-accepted": f"{SECOND}an order counts only if its beat rises",
    "second-publisher-accepted": f"{SECOND}both agents of the robot see each other, and hold",
    "freeze-unnoticed": f"{SECOND}what has waited is out of step, or too late by its stamps",
    "vote-not-restored": f"{SECOND}a restarted agent votes only after it was alone for long enough",
    "quarantine-skipped": f"{SECOND}a candidate does not count the vote of a new publisher for as long",
    "publisher-change-counts": f"{SECOND}a restarted agent does not vote for as long",
    "beat-binds-no-vote": f"{SECOND}votes are bound for longer than a lease lasts",
    "checksum-unchecked": f"{SECOND}half written state is no JSON",
    "stop-not-inherited": f"{SECOND}each robot keeps its own stop, and saves it",
    "old-integral-restored": "costs accuracy for seconds; only settling within 60 s is judged",
    "stops-file-not-atomic": "disks are in memory: a rehearsal writes no files",
    "beat-need-not-rise": f"{SECOND}a leader that is silent cannot be followed either",
    "late-order-accepted": f"{SECOND}positions that are as late are refused",
    "repeated-position-accepted": f"{SECOND}a repeated stamp is refused",
    "replayed-stamps-accepted": f"{SECOND}repeated counts are refused",
    "always-fresh": f"{SECOND}the leader's beat is silent as well",
    "late-messages-accepted": f"{SECOND}orders as late are refused",
    "brake-dropped": f"{SECOND}the way round others keeps room, and commands on the ramp are braked again",
    "brake-late": f"{SECOND}the way round others keeps room",
    "zone-behind": f"{SECOND}the collision filter avoids posts as well",
    "strangers-are-mates": f"{SECOND}the protective zones see whatever is near",
    "frozen-scan-unnoticed": "the frozen scan shows nothing that the robot meets before the fault ends",
    "no-way-out": "in these missions nobody is blocked for ever: the right of way decides",
    "nobody-yields": f"{SECOND}both brake, and evade",
    "silent-robots-forgotten": "no robot's way leads over a silent one; rehearsals do not place one there",
    "ramp-unbounded-time": "needs a robot that is slow and speeds up: slow processes hold before they do",
    "slot-velocity-added": "the error that it leaves is below the mission's bound",
    "index-shifted": "`replay` and `report` read chunks in order, and use no index",
    "recorded-before-1970": "verification uses the times in the traces; no rule reads the others",
    "lateness-unchecked": "no rule: without true stamps only motion shows a delay",
    "pose-not-restored": "needs odometry that restarts, of which there is no fault",
    "term-by-clock-only": "robots forget a term after 5 s of silence: the team goes on later, within 60 s",
    "remainder-forgotten": "the error that it leaves is below the mission's bound",
    "extrapolated-backwards": "the error that it leaves is below the mission's bound",
    "carried-unnoticed": "no rule: with a true position a robot drives back as it should",
    "speeds-unchecked": "no rule: wrong speeds beside true positions keep the formation",
    "sensor-doubt-dropped": "no rule limits the path with a frozen sensor of neighbours",
    "patience-inverted": "no fault keeps a robot away for longer than the leader waits",
    "unavailable-for-ever": "robots fall back on others, or follow one that is unavailable but moves",
}
"""By name of the defect, as far as it was looked into."""
