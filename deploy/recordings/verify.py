"""`formation replay FILE --verify`: compare the commands of today's agents with the recorded ones."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from formation.agent.verify.core import COMMAND_TOLERANCE, Verdict, Verification
from formation.agent.verify.replica import Comparison, PublishedCommand
from formation.deploy.arguments import add_json, add_law, number, parser, print_result, read_mission
from formation.deploy.refusal import refuse_errors, refuse_os_errors
from formation.deploy.terminal.bar import Bar
from formation.mission.file import parse
from formation.mission.model import Mission
from formation.monitor.recording.reader import Condition, Recording, UnreadableError, read

EXAMPLES = """\
  formation replay recordings/monday.mcap --verify
  formation replay monday.mcap --verify --mission changed.toml    what would other gains have commanded?
  formation replay monday.mcap --verify --json

A command is compared if all that it followed from is in the recording. Of a recording that begins after its
agents, the first seconds are not, up to the first state of each agent; these are reported, and do not count.

Exit code 0: no command differs; 1: at least one does; 2: there was nothing to compare; 3: none differs, but
of some robot's commands a smaller share was compared than --min-compared says.
"""
MIN_COMPARED_SHARE = 0.99
"""Default share of every robot's commands that must be compared for a verdict."""
EXIT_TOO_FEW = 3
"""Exit code if no command differs but too few were compared."""
MAX_SHOWN_STRETCHES = 5
"""Number of stretches of a robot that are listed; --json has them all."""


class Ran(NamedTuple):
    """A verification and its result."""

    recording: Recording
    condition: Condition
    """What of the recording cannot be read."""
    mission: Mission
    changed: bool
    """Whether the mission is not the recorded one."""
    verdicts: dict[str, Verdict]
    start: float
    """Start of the recording [s, the recorder's system clock]."""
    length: float
    """[s]"""
    took: float
    """[s]"""

    @property
    def compared(self) -> int:
        """Number of compared commands of all robots."""
        return sum(one.compared for one in self.verdicts.values())

    @property
    def first(self) -> tuple[str, Comparison] | None:
        """The first differing command of the whole fleet, with its robot."""
        firsts = [(name, one.first) for name, one in self.verdicts.items() if one.first is not None]
        return min(firsts, key=lambda found: found[1].wall, default=None)

    @property
    def least(self) -> tuple[str, float]:
        """The robot with the smallest share of compared commands, and that share, 0 to 1.

        Robots that only a changed mission has do not count.
        """
        recorded = self.recording.mission.followers
        shares = ((name, one.share) for name, one in self.verdicts.items() if name in recorded)
        return min(shares, key=lambda found: found[1], default=("", 0.0))


def main(arguments: Sequence[str]) -> int:
    """Verify a recording; return the exit code."""
    options = _options().parse_args(arguments)
    with refuse_errors(UnreadableError), refuse_os_errors(f"{options.file}: cannot be read"):
        ran = run(read(options.file), options.mission, options.law, options.tolerance)
    print_result(options, "\n".join(words(ran, options.min_compared)), lambda: report(ran))
    if not ran.compared:
        return 2
    if ran.first is not None:
        return 1
    return EXIT_TOO_FEW if ran.least[1] < options.min_compared else 0


def run(recording: Recording, changed: str | None, law: str | None, tolerance: float) -> Ran:
    """Run today's agents on a recording. Raises Refusal for an invalid mission."""
    mission = recording.mission if changed is None else read_mission(changed)
    verification = Verification(mission, law, tolerance)
    begin, extent = time.monotonic(), recording.extent()
    start, length = extent.start or 0.0, extent.duration
    with Bar(f"verifying {recording.path.name}") as bar:
        for count, message in enumerate(recording.messages()):
            if count % 1000 == 0 and length > 0.0:
                bar.at((message.sample.arrived - start) / length)
            verification.process_sample(message.sample, message.sample.arrived)
        verification.close()
    took = time.monotonic() - begin
    condition = recording.condition()
    return Ran(recording, condition, mission, changed is not None, verification.verdicts, start, length, took)


def words(ran: Ran, min_compared: float = MIN_COMPARED_SHARE) -> Iterator[str]:
    """Yield the result for people; `min_compared` is the share that every robot needs, 0 to 1."""
    verdicts = ran.verdicts.values()
    yield f"{ran.recording.path}: {ran.mission.name}, {len(verdicts)} agents, {ran.length:.1f} s"
    width = max(map(len, ran.verdicts)) + 2
    for one in verdicts:
        yield f"  {one.robot:<{width}}{_verdict(one)}"
        yield from (f"  {'':<{width}}{line}" for line in _details(one, ran.start))
    yield from (f"  note: {note}" for note in _notes(ran))
    pace = f"took {ran.took:.1f} s, {ran.length / max(ran.took, 1e-3):.1f} times as fast as the run"
    yield f"{_conclusion(ran, min_compared)}; {pace}"


def _conclusion(ran: Ran, min_compared: float) -> str:
    robot, share = ran.least
    if not ran.compared:
        return "nothing could be compared"
    if ran.first is not None:
        robot, first = ran.first
        return f"the first command that differs is {robot}'s at {first.wall - ran.start:.3f} s"
    if share >= min_compared:
        least = "all" if share == 1.0 else f"{share:.1%} or more"
        return f"no difference in {ran.compared} commands, {least} of every robot's"
    if not ran.verdicts[robot].commands:
        return f"no verdict: no command of {robot} in the recording (--min-compared 0 accepts that)"
    return (
        f"no verdict: only {share:.1%} of {robot}'s commands were compared, at least {min_compared:.1%} "
        "are needed (--min-compared); none of those compared differs"
    )


def _verdict(one: Verdict) -> str:
    if not one.commands:
        return "no command in the recording"
    compared = f"{one.compared} of {one.commands} commands compared"
    if one.lost:
        compared += f", {one.lost} more missing in the recording"
    if one.lead_in:
        compared += f" (and {one.lead_in} before the first state in its trace do not count)"
    if not one.compared:
        return compared
    if one.exact == one.compared:
        return f"{compared}, equal to the last bit"
    off = f"by {one.most_off[0]:.3g} m/s and {one.most_off[1]:.3g} rad/s at most"
    if one.differing and not math.isfinite(max(one.most_off)):  # one of the two gave no command
        return f"{compared}, {one.differing} DIFFER"
    if one.differing:
        return f"{compared}, {one.differing} DIFFER, {off}"
    return f"{compared}, {one.exact} equal to the last bit, the rest off {off}"


def _details(one: Verdict, start: float) -> Iterator[str]:
    if one.first is not None:
        yield f"first at {one.first.wall - start:.3f} s, command {one.first.number} of its agent:"
        yield f"  recorded {_command(one.first.recorded)}"
        yield f"  computed {_command(one.first.computed)}, {one.first.decision}"
        newest = one.first.inputs[-MAX_SHOWN_STRETCHES:]
        after = ", ".join(f"{received.key} ({received.age * 1e3:.1f} ms)" for received in newest)
        yield f"  after {after or 'no message'}"
    for stretch in one.unjudged[:MAX_SHOWN_STRETCHES]:
        since, until = stretch.since - start, stretch.until - start
        many = "1 command" if stretch.commands == 1 else f"{stretch.commands} commands"
        span = f"{since:.1f} to {until:.1f} s" if stretch.commands > 1 else f"{since:.1f} s"
        yield f"not judged: {many}, {span}: {stretch.reason}"
    if len(one.unjudged) > MAX_SHOWN_STRETCHES:
        yield f"… and {len(one.unjudged) - MAX_SHOWN_STRETCHES} more stretches that were not judged"


def _command(sent: PublishedCommand | None) -> str:
    return "none" if sent is None else f"u {sent.speed:+.9f} m/s, ω {sent.turn_rate:+.9f} rad/s"


def _notes(ran: Ran) -> Iterator[str]:
    if ran.condition.words:
        yield f"the recording is {ran.condition.words}: commands that cannot be read are not compared"
    if ran.changed:
        if ran.mission.name != ran.recording.mission.name:
            yield f"the recording is of mission {ran.recording.mission.name}, not of {ran.mission.name}"
        if left_out := sorted(set(ran.recording.mission.followers) - set(ran.verdicts)):
            yield f"left out, because {ran.mission.name} has no such follower: {', '.join(left_out)}"
        return
    # agents say the fingerprint of the file, in a rehearsal that of the mission under the law of that run
    recorded = {parse(ran.recording.about["mission_file"]).fingerprint, ran.mission.fingerprint}
    others = [one.robot for one in ran.verdicts.values() if one.missions - recorded]
    if others:
        yield f"the agents of {', '.join(others)} drove by another mission than the recorded one"


def report(ran: Ran) -> dict[str, Any]:
    """Return the result for a script. Times are seconds into the recording."""
    return {
        "recording": str(ran.recording.path),
        "mission": ran.mission.name,
        "length": ran.length,
        "took": ran.took,
        "commands": sum(one.commands for one in ran.verdicts.values()),
        "compared": ran.compared,
        "least_share": ran.least[1],
        "exact": sum(one.exact for one in ran.verdicts.values()),
        "differing": sum(one.differing for one in ran.verdicts.values()),
        "first": None if ran.first is None else {"robot": ran.first[0], **_first(ran.first[1], ran.start)},
        "notes": list(_notes(ran)),
        "robots": {name: _robot(one, ran.start) for name, one in ran.verdicts.items()},
    }


def _robot(one: Verdict, start: float) -> dict[str, Any]:
    counts = "commands", "compared", "lost", "lead_in", "share", "exact", "differing"
    return {
        **{name: getattr(one, name) for name in counts},
        "most_off": {"speed": one.most_off[0], "turn_rate": one.most_off[1]},
        "first": None if one.first is None else _first(one.first, start),
        "not_judged": [
            {**asdict(stretch), "since": stretch.since - start, "until": stretch.until - start}
            for stretch in one.unjudged
        ],
    }


def _first(one: Comparison, start: float) -> dict[str, Any]:
    def command(sent: PublishedCommand | None) -> dict[str, float] | None:
        return None if sent is None else {"speed": sent.speed, "turn_rate": sent.turn_rate}

    return {
        "at": one.wall - start,
        "command": one.number,
        "recorded": command(one.recorded),
        "computed": command(one.computed),
        "decision": one.decision,
        "inputs": [received._asdict() for received in one.inputs],
    }


def _options() -> argparse.ArgumentParser:
    options = parser(
        "replay FILE --verify",
        "Have today's agents process a recording again, and compare what they command.",
        EXAMPLES,
    )
    options.add_argument("file", metavar="FILE", type=Path, help="the recording; any part of it")
    options.add_argument("--verify", action="store_true", help=argparse.SUPPRESS)
    options.add_argument(
        "--mission", metavar="MISSION", help="go by this mission instead of the recorded one"
    )
    add_law(options, "instead of the one that was used")
    options.add_argument(
        "--tolerance", type=number(0.0), default=COMMAND_TOLERANCE, metavar="X",
        help=f"how far off a command still counts as the same [m/s; rad/s] (default {COMMAND_TOLERANCE:g})",
    )  # fmt: skip
    options.add_argument(
        "--min-compared", type=number(0.0, 1.0), default=MIN_COMPARED_SHARE, metavar="SHARE",
        help="share of every robot's commands that has to be compared, 0 to 1; with less the exit code is"
        f" {EXIT_TOO_FEW} (default {MIN_COMPARED_SHARE:g})",
    )  # fmt: skip
    add_json(options)
    return options
