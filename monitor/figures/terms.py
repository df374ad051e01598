"""Who leads by a term. Without standbys it is always the leader's own process."""

from __future__ import annotations

from formation.election import rank_of
from formation.mission import Mission


def leader_of(mission: Mission, term: int) -> str:
    """Name of the process that leads in `term`; empty if the mission knows of none such."""
    if not mission.standbys:
        return mission.leader
    rank = rank_of(term)
    return mission.candidates[rank] if rank < len(mission.candidates) else ""
