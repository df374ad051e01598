"""Check that there is a leader, if there are standbys."""

from __future__ import annotations

from collections.abc import Iterator

from formation.deploy.doctor.facts import Examination, Facts, Finding


def look(facts: Facts) -> Iterator[Finding]:
    """Yield a finding if none leads although a candidate's messages arrive."""
    if facts.leading == ():
        candidates = ", ".join(facts.mission.candidates)
        yield Finding(
            "no-leader",
            f"no leader: none of {candidates} says that it does",
            "start one; one that runs must be linked with more than half of the followers",
        )


def well(facts: Facts) -> str:
    """Return the leader. If a takeover happened while listening, the earlier one may be included."""
    return f"{' and '.join(facts.leading)} said that it leads" if facts.leading else ""


LEADING = Examination("leader", look, well)
