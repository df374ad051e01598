"""A run in numbers: those that stand on top of its page, in its JSON, and beside another run's."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from monitor.figures.feed import CLOCK_AGREES
from monitor.figures.known import NOTHING
from monitor.report import words
from monitor.report.gather import Run
from monitor.report.judging import Measured
from monitor.report.reigns import overlaps
from monitor.report.traffic import Key

APART = 0.01
"""A settling time that differs more from the monitor's own is worth a word [s]."""
BEFORE = 1.0
"""Who falls silent so much earlier than the others was lost [s]."""


class Item(NamedTuple):
    """One number of a run."""

    name: str
    """Its key in JSON."""
    title: str
    value: float | None
    """SI; None is: not known."""
    write: Callable[[float | None], str]

    @property
    def text(self) -> str:
        """For people."""
        return self.write(self.value)


def items(run: Run) -> Iterator[Item]:
    """Everything that one number says of a run."""
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
    delays = [late for late in run.answers.values() if late.median is not None]
    median = max((late.median or 0.0 for late in delays), default=None)
    p99 = max((late.p99 or 0.0 for late in delays), default=None)
    yield Item("answer_median", "odometry → command, median, slowest robot", median, words.milliseconds)
    yield Item("answer_p99", "odometry → command, p99, slowest robot", p99, words.milliseconds)
    gaps = [key.gap for key in run.keys if key.topic == "position" and key.gap is not None]
    yield Item("longest_gap", "longest silence of a position", max(gaps, default=None), words.milliseconds)
    yield Item("missed", "missed messages", run.snapshot.missed, words.whole)
    yield Item("rejected", "rejected messages", sum(run.snapshot.rejected.values()), words.whole)
    yield Item("messages", "messages", run.messages, words.whole)
    yield Item("duration", "duration", run.duration, words.lasting)


def as_json(run: Run) -> dict[str, Any]:
    """A run for a script; SI, None where something is not known."""
    return {
        "recording": str(run.recording.path),
        "mission": run.mission.name,
        "law": run.mission.law.kind,
        "converged": run.snapshot.converged,
        "cut": run.recording.is_cut(),
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
        "latency": {topic: asdict(late) for topic, late in run.late.items()},
        "answers": {name: asdict(late) for name, late in run.answers.items()},
    }


def verdict(run: Run) -> str:
    """How it went, in one sentence."""
    bound = words.bound(run.mission.settled)
    if not run.messages:
        return "Nothing was recorded."
    if not run.known:
        return "The formation error was never known: some robot was not heard."
    if run.snapshot.final_error is None:
        return _of_known(run, bound)
    if run.snapshot.settled_at is None:
        return f"Not settled: the formation error was not under {bound} at the end."
    since = f"under {bound} since {words.seconds(run.snapshot.settled_at)}"
    return f"Converged: formation error {since}." if run.snapshot.converged else f"Just settled: {since}."


def _of_known(run: Run, bound: str) -> str:
    """How it went where not all edges are known at the end."""
    known = run.snapshot.known_verdict
    if known.final is None:
        return "Not known at the end: a robot was lost before the others."
    over = f"over {known.final.words}"
    if known.settled_at is None:
        return f"Not settled {over}: their error was not under {bound} at the end."
    since = f"under {bound} since {words.seconds(known.settled_at)}"
    return f"{'Converged' if known.converged else 'Just settled'} {over}: error {since}."


def notices(run: Run, *, cut: bool) -> Iterator[str]:
    """What whoever reads the figures should know first."""
    if cut:
        yield (
            "This recording is cut: its recorder was killed or is still at work. It was read as far as it"
            f" goes, {words.lasting(run.duration)}."
        )
    if not run.messages:
        return
    for former, latter, span in overlaps(run.reigns):
        yield (
            f"Two led at once: {former.name or 'somebody'} and {latter.name or 'somebody'}, for"
            f" {words.lasting(span.end - span.begin)} from {words.seconds(span.begin - run.start)} on."
        )
    unheard = [key.robot for key in run.keys if key.topic == "position" and not key.count]
    if unheard:
        yield f"Never heard: {_listed(unheard)}. So the sum over all edges is not known."
    lost = lost_robots(run.keys)
    if lost:
        told = [f"{name} {words.lasting(quiet)} before the others" for name, quiet in lost]
        yield f"Fell silent and did not come back: {_listed(told)}."
    if not run.truth:
        yield "No ground truth was recorded, as in the field: true errors and heading errors are not known."
    wrong = sorted({key.robot for key in run.keys if key.clock is not None and not _agrees(key.clock)})
    if wrong:
        yield f"Clocks differ from the recorder's: {_listed(wrong)}. Their delays contain the difference."
    if abs(run.apart) > APART:
        yield (
            "The recorder's system clock was set during the run: times here are off by up to"
            f" {words.milliseconds(abs(run.apart))}."
        )
    if run.untold:
        yield f"{words.whole(run.untold)} more events were recorded than are listed here."


def lost_robots(keys: Sequence[Key]) -> list[tuple[str, float]]:
    """Robots that fell silent before the others did, and how much earlier [s]."""
    positions = {key.robot: key.quiet for key in keys if key.topic == "position" and key.quiet is not None}
    last = min(positions.values(), default=0.0)
    return [(robot, quiet - last) for robot, quiet in positions.items() if quiet - last > BEFORE]


def _measured(
    name: str, title: str, measured: Measured, write: Callable[[float | None], str]
) -> Iterator[Item]:
    whole, after = measured.whole, measured.after
    yield Item(f"{name}_rms", f"RMS {title}", whole.rms, write)
    yield Item(f"{name}_max", f"greatest {title}", whole.maximum, write)
    yield Item(f"{name}_rms_settled", f"RMS {title}, settled", after.rms if after else None, write)
    yield Item(f"{name}_max_settled", f"greatest {title}, settled", after.maximum if after else None, write)


def _agrees(clock: float) -> bool:
    return CLOCK_AGREES[0] <= clock <= CLOCK_AGREES[1]


def _listed(names: Sequence[str]) -> str:
    shown = ", ".join(names[:8])
    return shown if len(names) <= 8 else f"{shown} and {len(names) - 8} more"
