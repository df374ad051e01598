"""A run in numbers: for the top of its page, its JSON, and the comparison with another run."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from formation.mission.model import Mission
from formation.monitor.metrics.feed import clock_agrees
from formation.monitor.metrics.settling import DWELL_TIME, NOTHING
from formation.monitor.report import words
from formation.monitor.report.gather import Run
from formation.monitor.report.leader_terms import overlaps
from formation.monitor.report.thin import Measured
from formation.monitor.report.traffic import Key

MIN_CLOCK_DIFFERENCE = 0.01
"""Difference of elapsed time from the monitor's own from which on it is reported [s]."""
EARLIER_SILENCE = 1.0
"""A robot that falls silent earlier than the others by this much counts as lost [s]."""
IN_TRANSITION = "a shape transition was under way at the end"
"""Why nothing has settled, however small the error is."""


class Item(NamedTuple):
    """One number of a run."""

    name: str
    """Its key in JSON."""
    title: str
    value: float | None
    """In SI units; None means unknown."""
    write: Callable[[float | None], str]

    @property
    def text(self) -> str:
        """Return the value for people."""
        return self.write(self.value)


def items(run: Run) -> Iterator[Item]:
    """Yield every number of a run."""
    yield Item("settling_time", "settling time", run.snapshot.settling_time, words.seconds)
    yield Item("formation_error", "final formation error", run.snapshot.final_error, words.length)
    last = run.snapshot.known_verdict.final or NOTHING
    yield Item("known_error", "final error over the known edges", last.error, words.length)
    yield Item("known_edges", "edges known at the end", last.known_edges, words.whole)
    yield Item("edges", "edges", last.edges, words.whole)
    true = None if run.snapshot.final_error is None else run.true_error.final
    yield Item("formation_error_true", "final true error", true, words.length)
    yield from _measured("error", "formation error", run.error, words.length)
    for index, what in enumerate(("u", "ω")):
        shares = [robot.saturated[index] for robot in run.robots.values()]
        known = [share for share in shares if share is not None]
        worst = max(known, default=None)
        name = f"{('speed', 'turn')[index]}_saturated"
        yield Item(name, f"commands at the limit of {what}, worst robot", worst, words.share)
    delays = [answer for answer in run.answers.values() if answer.median is not None]
    median = max((answer.median or 0.0 for answer in delays), default=None)
    p99 = max((answer.p99 or 0.0 for answer in delays), default=None)
    yield Item("answer_median", "odometry → command, median, slowest robot", median, words.milliseconds)
    yield Item("answer_p99", "odometry → command, p99, slowest robot", p99, words.milliseconds)
    gaps = [key.gap for key in run.keys if key.topic == "position" and key.gap is not None]
    yield Item("longest_gap", "longest silence of a position", max(gaps, default=None), words.milliseconds)
    yield Item("missed", "missed messages", run.snapshot.missed, words.whole)
    yield Item("rejected", "rejected messages", sum(run.snapshot.rejected.values()), words.whole)
    yield Item("messages", "messages", run.messages, words.whole)
    yield Item("duration", "duration", run.duration, words.lasting)


def as_json(run: Run) -> dict[str, Any]:
    """Return a run for a script; SI units, None for unknown values."""
    return {
        "recording": str(run.recording.path),
        "mission": run.mission.name,
        "law": run.mission.law.kind,
        "converged": run.snapshot.converged,
        "cut": run.condition.is_cut,
        "damaged_stretches": run.condition.damaged,
        **{item.name: item.value for item in items(run)},
        "robots": {
            name: {
                **{item.name: item.value for item in _measured("error", "", robot.error, words.length)},
                **{item.name: item.value for item in _measured("heading", "", robot.heading, words.degrees)},
                "final_error": robot.error.final,
                "speed_saturated": robot.saturated[0],
                "turn_saturated": robot.saturated[1],
            }
            for name, robot in run.robots.items()
        },
        "latency": {topic: asdict(delays) for topic, delays in run.delays.items()},
        "answers": {name: asdict(delays) for name, delays in run.answers.items()},
    }


def verdict(run: Run) -> str:
    """Return the result in one sentence."""
    bound = words.bound(run.mission.settled)
    if not run.messages:
        return "Nothing was recorded."
    if not run.known:
        return "The formation error was never known: positions of some robot are missing."
    if run.snapshot.final_error is None:
        return _known_verdict(run, bound)
    if run.snapshot.settled_at is None:
        why = f"the formation error was not under {bound} at the end"
        return f"Not settled: {why if run.snapshot.formed else IN_TRANSITION}."
    since = f"under {bound} since {words.seconds(run.snapshot.settled_at)}"
    if run.snapshot.converged:
        return f"Converged: formation error {since}."
    return f"Just settled: {since}; converged means under it for at least {DWELL_TIME:g} s."


def _known_verdict(run: Run, bound: str) -> str:
    """Return the result if not all edges are known at the end."""
    known = run.snapshot.known_verdict
    if known.final is None:
        return "Not known at the end: a robot was lost before the others."
    over = f"over {known.final.words}"
    if known.settled_at is None:
        why = f"their error was not under {bound} at the end"
        return f"Not settled {over}: {why if run.snapshot.formed else IN_TRANSITION}."
    since = f"under {bound} since {words.seconds(known.settled_at)}"
    if known.converged:
        return f"Converged {over}: error {since}."
    return f"Just settled {over}: error {since}; converged means under it for at least {DWELL_TIME:g} s."


def notices(run: Run) -> Iterator[str]:
    """Yield the notices to read before the metrics."""
    if run.condition.words:
        yield (
            f"This recording is {run.condition.words}. Its readable part spans"
            f" {words.lasting(run.duration)}; messages lost in gaps count as missed."
        )
    if not run.messages:
        return
    for former, latter, span in overlaps(run.leader_terms):
        yield (
            f"Two leaders at once: {former.name or 'an unknown leader'} and"
            f" {latter.name or 'an unknown one'}, for {words.lasting(span.end - span.begin)}"
            f" from {words.seconds(span.begin - run.start)} on."
        )
    never_received = [key.robot for key in run.keys if key.topic == "position" and not key.count]
    if never_received:
        yield f"Never received: {_listed(never_received)}. So the sum over all edges is not known."
    lost = lost_robots(run.keys)
    if lost:
        silences = [f"{name} {words.lasting(quiet)} before the others" for name, quiet in lost]
        yield f"Fell silent and did not come back: {_listed(silences)}."
    if not run.truth:
        yield "No ground truth was recorded, as in the field: true errors and heading errors are not known."
    wrong = sorted({key.robot for key in run.keys if key.clock is not None and not clock_agrees(key.clock)})
    if wrong:
        yield f"Clocks differ from the recorder's: {_listed(wrong)}. Their delays contain the difference."
    yield from _clock_notices(run)
    if run.story.unlisted:
        yield f"{words.whole(run.story.unlisted)} more events were recorded than are listed here."


def _clock_notices(run: Run) -> Iterator[str]:
    """Yield how the recorder's clock was set, and by how much times are off for it."""
    steps = [f"by {one.step:+.3f} s at {words.seconds(one.at - run.start)}" for one in run.story.clock_steps]
    if steps:
        yield f"The recorder's system clock was set {_listed(steps)}: times here are as if it had not been."
    if abs(run.story.elapsed_excess) > MIN_CLOCK_DIFFERENCE:
        yield (
            "The recorder's system clock was set during the run: times here are off by up to"
            f" {words.milliseconds(abs(run.story.elapsed_excess))}."
        )


def lost_robots(keys: Sequence[Key]) -> list[tuple[str, float]]:
    """Return the robots that fell silent before the others, and how much earlier [s]."""
    positions = {key.robot: key.quiet for key in keys if key.topic == "position" and key.quiet is not None}
    last = min(positions.values(), default=0.0)
    return [(robot, quiet - last) for robot, quiet in positions.items() if quiet - last > EARLIER_SILENCE]


def _measured(
    name: str, title: str, measured: Measured, write: Callable[[float | None], str]
) -> Iterator[Item]:
    whole, after = measured.whole, measured.after
    yield Item(f"{name}_rms", f"RMS {title}", whole.rms, write)
    yield Item(f"{name}_max", f"greatest {title}", whole.maximum, write)
    yield Item(f"{name}_rms_settled", f"RMS {title}, settled", after.rms, write)
    yield Item(f"{name}_max_settled", f"greatest {title}, settled", after.maximum, write)


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:8])
    return shown if len(names) <= 8 else f"{shown} and {len(names) - 8} more"


def comparison(first: Run, second: Run) -> str:
    """Return in a sentence which run settled sooner."""
    a, b = first.snapshot.settled_at, second.snapshot.settled_at
    if a is None or b is None:
        times = [words.seconds(time) if time is not None else "never" for time in (a, b)]
        return f"Settled for good: A {times[0]}, B {times[1]}."
    by = f" ({words.ratio(max(a, b) / min(a, b))})" if min(a, b) > 0.0 else ""
    sooner, later = ("A", "B") if a <= b else ("B", "A")
    return f"{sooner} settled after {words.seconds(min(a, b))}, {later} after {words.seconds(max(a, b))}{by}."


def compared_items(first: Run, second: Run) -> Iterator[tuple[str, str, str, str]]:
    """Yield every number of either run: its title, both values, and the ratio of the second to the first."""
    for a, b in zip(items(first), items(second), strict=True):
        if a.value is not None or b.value is not None:
            yield a.title, a.write(a.value), b.write(b.value), _ratio(a.value, b.value)


def compared_robots(first: Run, second: Run) -> Iterator[tuple[str, str, str, str]]:
    """Yield the RMS error of every follower in both runs, likewise."""
    for name in first.mission.followers:
        if name in second.robots:
            a, b = first.robots[name].error.whole.rms, second.robots[name].error.whole.rms
            yield name, words.length(a), words.length(b), _ratio(a, b)


def differences(first: Mission, second: Mission) -> list[str]:
    """Return the differences of two missions except law and name, as `key: one, other`."""
    a, b = first.model_dump(mode="json"), second.model_dump(mode="json")
    for one in (a, b):
        one["law"].pop("kind")
        one.pop("name")
    return list(_differ("", a, b))


def _differ(where: str, a: Any, b: Any) -> Iterator[str]:
    if isinstance(a, dict) and isinstance(b, dict):
        for key in [*a, *(key for key in b if key not in a)]:
            below = f"{where}.{key}" if where else key
            if key not in a or key not in b:
                yield f"{below}: only in {'A' if key in a else 'B'}"
            else:
                yield from _differ(below, a[key], b[key])
    elif a != b:
        yield f"{where}: {_short(a)} in A, {_short(b)} in B"


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:59]}…"


def _ratio(a: float | None, b: float | None) -> str:
    return words.ratio(b / a if a and b is not None else None)
