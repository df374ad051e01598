"""Check the robot's odometry: rate, regularity, decoding, and the frame that the mission expects."""

from __future__ import annotations

from collections.abc import Iterator

from formation.control.tracker import FRESH_PERIODS
from formation.deploy.doctor.facts import Examination, Facts, Finding, Stream

MIN_RATE_SHARE, MAX_RATE_SHARE = 0.8, 1.4
"""Lowest and highest share of the mission's rate."""
IRREGULAR_PAUSES = 2
"""Number of pauses while listening that counts as irregular; one may happen."""


def look(facts: Facts) -> Iterator[Finding]:
    """Yield findings about odometry, or about the external pose that replaces it."""
    if facts.router_trouble:
        return  # one explains the other
    if facts.odometry is not None:
        yield from _stream(facts, "odometry", "odometry", facts.odometry)
        yield from _frame(facts, facts.odometry)
    if facts.pose is not None:
        yield from _stream(facts, "pose", "the external pose", facts.pose)


def well(facts: Facts) -> str:
    """Return rate and frame."""
    stream = facts.odometry
    if stream is None or not stream.received:
        return ""
    return f"{stream.rate:.3g} Hz, frame {', '.join(sorted(stream.frames)) or 'without a name'}"


def _stream(facts: Facts, name: str, what: str, stream: Stream) -> Iterator[Finding]:
    wanted, rate = 1.0 / facts.period, stream.rate
    limit = FRESH_PERIODS * facts.period
    pauses = [gap for gap in stream.gaps if gap > limit]
    if stream.bad:
        yield Finding(
            f"{name}-unreadable",
            f"{len(stream.bad)} messages on {what} cannot be used: {stream.bad[-1]}",
            "see what publishes there, and with which type",
        )
    if not stream.received:
        if not stream.bad:
            yield Finding(
                f"{name}-silent",
                f"no {what.removeprefix('the ')} in {facts.seconds:g} s",
                "is the bring-up up, in the namespace and domain that the mission says?",
            )
    elif rate < MIN_RATE_SHARE * wanted:
        yield Finding(
            f"{name}-slow",
            f"{what} comes at {rate:.3g} Hz instead of {wanted:.3g} Hz",
            "is the computer overloaded or hot (vcgencmd get_throttled)? else correct the mission's rate",
        )
    elif rate > MAX_RATE_SHARE * wanted:
        yield Finding(
            f"{name}-fast",
            f"{what} comes at {rate:.3g} Hz instead of {wanted:.3g} Hz",
            "do two processes publish it? else correct the mission's rate",
        )
    elif len(pauses) >= IRREGULAR_PAUSES:
        yield Finding(
            f"{name}-irregular",
            f"{what} paused {len(pauses)} times in {facts.seconds:g} s, for up to {max(pauses):.2f} s",
            "each pause stops the robot: is the computer overloaded, is Wi-Fi power saving on?",
        )


def _frame(facts: Facts, stream: Stream) -> Iterator[Finding]:
    spec = facts.mission.robots[facts.robot]
    if len(stream.frames) > 1:
        yield Finding(
            "odometry-frames",
            f"odometry comes in several frames: {', '.join(sorted(stream.frames))}",
            "two processes publish it: end one of them",
        )
    in_world = spec.localisation == "odometry" and spec.odometry_frame == "world"
    if in_world and any(frame.rpartition("/")[2] == "odom" for frame in stream.frames):
        yield Finding(
            "odometry-frame",
            "odometry counts in its own frame odom, but the mission takes it for the world's",
            f'say odometry_frame = "start" in [robots.{facts.robot}], and switch it on at its start',
        )


ODOMETRY = Examination("odometry", look, well)
