"""Defects of the election: votes, leases, terms."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

CANDIDACY, RULES = "leader/candidacy.py", "formation/protocol/election.py"

DEFECTS = (
    Defect(
        "majority-of-half",
        CANDIDACY,
        "self._majority = len(mission.followers) // 2 + 1",
        "self._majority = len(mission.followers) // 2",
        "two candidates may both have enough votes",
        ("votes", "leadercut"),
    ),
    Defect(
        "lease-by-newest-vote",
        CANDIDACY,
        "return newest[self._majority - 1] + self._in_takeovers(LEASE_TIME)",
        "return newest[0] + self._in_takeovers(LEASE_TIME)",
        "one robot alone keeps a leader in office",
        ("votes", "leadercut"),
    ),
    Defect(
        "lease-too-long",
        RULES,
        "LEASE_TIME = 0.5\n",
        "LEASE_TIME = 5.0\n",
        "a leader leads on when its votes are long free",
        ("leadercut", "muted"),
    ),
    Defect(
        "lease-unchecked",
        CANDIDACY,
        "if self.leading and now.mono >= self._ends_at:",
        "if self.leading and now.mono >= self._ends_at + 1e3:",
        "a leader that lost its votes goes on",
        ("leadercut", "muted"),
    ),
    Defect(
        "vote-counted-twice",
        CANDIDACY,
        "self._voted_at[robot] = max(sent, self._voted_at.get(robot, sent))",
        'self._voted_at[f"{robot} {attachment.last_ballot}"] = sent',
        "a robot's vote counts twice",
        ("votes", "leadercut"),
    ),
    Defect(
        "vote-not-bound",
        RULES,
        "free = arrived - state.renewed >= self._bound",
        "free = arrived - state.renewed >= 0.0",
        "a robot votes for two candidates at once",
        ("votes", "leadercut"),
    ),
    Defect(
        "beat-binds-no-vote",
        RULES,
        "return free and (ballot.term == state.voted_term or arrived - state.rose >= self._bound)",
        "return free",
        "a robot that receives a leader votes for another",
        ("muted", "votes"),
    ),
    Defect(
        "quarantine-skipped",
        RULES,
        "if state.alone is None or arrived - state.alone < self._quarantine:",
        "if state.alone is None:",
        "a restarted agent votes at once",
        ("crashed", "votes"),
    ),
    Defect(
        "publisher-change-counts",
        CANDIDACY,
        "return arrived - known.since >= self._in_takeovers(VOTE_BOUND_TIME)",
        "return arrived >= known.since",
        "two agents of one robot both vote",
        ("votes", "second"),
    ),
    Defect(
        "term-by-clock-only",
        RULES,
        "base = max(base, known + 1 + int(now.mono * 1e9) % 10**9)",
        "base = max(base, 0)",
        "a leader with a late clock is refused",
        ("clocks",),
    ),
    Defect(
        "takeover-unit",
        RULES,
        "LEADERLESS_TIME = 0.6\n",
        "LEADERLESS_TIME = 600.0\n",
        "no standby takes over",
        ("killed",),
    ),
)
