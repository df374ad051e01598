"""Where there are standbys: does anybody lead?"""

from __future__ import annotations

from collections.abc import Iterator

from deploy.doctor.facts import Examination, Facts, Finding

LEADS, YES = "leads", "yes"
"""Key and value of the status of who leads."""


def look(facts: Facts) -> Iterator[Finding]:
    """Nobody, though somebody who could was heard."""
    if facts.leading == ():
        candidates = ", ".join(facts.mission.candidates)
        yield Finding(
            "nobody-leads",
            f"nobody leads: none of {candidates} says that it does",
            "start one; one that runs must be linked with more than half of the followers",
        )


def well(facts: Facts) -> str:
    """Who does. After a takeover the one before it may have said so as well, while we listened."""
    return f"{' and '.join(facts.leading)} said that it leads" if facts.leading else ""


LEADING = Examination("leader", look, well)
