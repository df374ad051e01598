"""Are the certificates valid, for long enough, of the right name, with their keys, and kept secret?"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from deploy.doctor.facts import Certificate, Examination, Facts, Finding

LEFT = 0.2
"""Share of its life from which a certificate is about to expire."""
OTHERS = 0o007
"""Rights of everybody on the machine."""
RENEW = "formation deploy certificates MISSION --out DIR --renew, then bundle and push"


def look(facts: Facts) -> Iterator[Finding]:
    """Each certificate that was found."""
    for one in facts.certificates or ():
        yield from _one(one, facts.wall)


def well(facts: Facts) -> str:
    """How long the first to expire still lasts."""
    usable = [one for one in facts.certificates or () if not one.problem]
    if not usable:
        return ""
    first = min(usable, key=lambda one: one.ends)
    return f"{first.name} is valid for {span(first.ends - facts.wall)}"


def span(seconds: float) -> str:
    """A length of time for people."""
    if abs(seconds) >= 2 * 86_400:
        return f"{seconds / 86_400:.0f} days"
    return f"{seconds / 3_600:.1f} hours" if abs(seconds) >= 5_400 else f"{seconds / 60:.0f} minutes"


def _one(one: Certificate, now: float) -> Iterator[Finding]:
    if one.problem:
        yield Finding("certificate-unusable", f"{one.path}: {one.problem}", RENEW)
        return
    if one.name != one.wanted:
        yield Finding(
            "certificate-name",
            f"{one.path} is the certificate of {one.name!r}, not of {one.wanted!r}",
            "each process needs its own: make the bundles again, and push",
        )
    if one.mode & OTHERS:
        yield Finding(
            "key-readable",
            f"the key of {one.path} is readable by others (mode {one.mode:03o})",
            "chmod o= the key; if anybody may have read it, renew it",
        )
    if now >= one.ends:
        when = f"{datetime.fromtimestamp(one.ends, UTC):%Y-%m-%d %H:%M} UTC"
        yield Finding("certificate-expired", f"{one.path} has expired on {when}", RENEW)
    elif now < one.begins:
        yield Finding(
            "certificate-not-yet-valid",
            f"{one.path} becomes valid in {span(one.begins - now)}, by this machine's clock",
            "the clock is behind: set it, let chrony run",
        )
    elif one.ends - now < LEFT * (one.ends - one.begins):
        yield Finding("certificate-expires", f"{one.path} expires in {span(one.ends - now)}", RENEW)


CERTIFICATES = Examination("certificate", look, well)
