"""Check certificates: valid, for long enough, right name, matching keys, kept secret."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from formation.deploy.doctor.facts import Certificate, Examination, Facts, Finding

EXPIRING_LIFE_SHARE = 0.2
"""Remaining share of its life at which a certificate counts as about to expire."""
OTHERS_MODE_BITS = 0o007
"""File mode bits of all other users."""
RENEW = "formation deploy certificates MISSION --out DIR --renew, then bundle and push"


def look(facts: Facts) -> Iterator[Finding]:
    """Yield findings about each certificate found."""
    for one in facts.certificates or ():
        yield from _one(one, facts.wall)


def well(facts: Facts) -> str:
    """Return the time until the first certificate expires."""
    usable = [one for one in facts.certificates or () if not one.problem]
    if not usable:
        return ""
    first = min(usable, key=lambda one: one.ends)
    return f"{first.name} is valid for {span(first.ends - facts.wall)}"


def span(seconds: float) -> str:
    """Return a duration for people."""
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
    if one.mode & OTHERS_MODE_BITS:
        yield Finding(
            "key-readable",
            f"the key of {one.path} is readable by others (mode {one.mode:03o})",
            "chmod o= the key; if another user may have read it, renew it",
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
    elif one.ends - now < EXPIRING_LIFE_SHARE * (one.ends - one.begins):
        yield Finding("certificate-expires", f"{one.path} expires in {span(one.ends - now)}", RENEW)


CERTIFICATES = Examination("certificate", look, well)
