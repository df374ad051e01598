"""The leading candidate of a term. Without standbys it is always the leader's own process."""

from __future__ import annotations

from formation.mission.model import Mission
from formation.protocol.election import rank_of


def leader_of(mission: Mission, term: int) -> str:
    """Return the name of the candidate that leads in `term`; empty if the mission has none."""
    if not mission.standbys:
        return mission.leader
    rank = rank_of(term)
    return mission.candidates[rank] if rank < len(mission.candidates) else ""
