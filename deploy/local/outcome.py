"""The result of a run: one JSON object and a few lines for people, from its processes' summaries."""

from __future__ import annotations

import shlex
import signal
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from formation.deploy.local.launch import Child
from formation.deploy.local.plan import leaders
from formation.deploy.terminal.units import metres
from formation.mission.model import Mission
from formation.monitor.metrics.settling import DWELL_TIME, KnownError, KnownVerdict
from formation.topics import GROUND_TRUTH, POSITION


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of a run."""

    mission: Mission
    children: Sequence[Child]
    duration: float
    """Time since all were ready [s]."""
    logs: Path
    interrupted: bool = False
    record: Path | None = None
    """The monitor's recording file."""

    @property
    def monitor(self) -> Mapping[str, Any]:
        """The monitor's summary; empty if it gave none."""
        found = (child.summary for child in self.children if child.part == "watch")
        return next(found, None) or {}

    @property
    def converged(self) -> bool:
        """Whether the formation error fell, and stayed, under the mission's bound."""
        return self.monitor.get("converged") is True

    @property
    def faults(self) -> list[str]:
        """Faults of the processes."""
        bad = [child for child in self.children if not ended_well(child) and child not in self.replaced]
        failure = self.monitor.get("recording_failure")
        unrecorded = [f"monitor stopped recording: {failure}"] if failure else []
        if lacking := self.monitor.get("recording_lost"):
            unrecorded.append(f"the recording lacks {lacking} messages that the monitor received")
        if overflowed := self.monitor.get("dropped", {}).get("overflowed"):
            unrecorded.append(f"the monitor was too slow for {overflowed} messages; the recording lacks them")
        return [
            f"{child.name} {how_it_ended(child)}{' during the run' if child.died else ''}" for child in bad
        ] + unrecorded

    @property
    def replaced(self) -> list[Child]:
        """Candidates that were stopped or killed, while another stood by to the end as intended."""
        names = set(leaders(self.mission).values())
        candidates = [child for child in self.children if child.name in names]
        if not any(ended_well(child) for child in candidates):
            return []
        return [child for child in candidates if child.died and (child.exit or 0) <= 0]

    @property
    def lost(self) -> int | None:
        """Number of messages published and not recorded; None if the monitor gave no summary.

        Counted are all messages to the fleet, and ground truth from simulated robots. Odometry counts as
        repeated by the agents. The leader's positions are summed over all that have led; their number is
        unknown if one of them was killed.
        """
        recorded: Mapping[str, int] | None = self.monitor.get("recorded")
        if recorded is None:
            return None
        truths = {GROUND_TRUTH.key(name) for name in self.mission.followers}
        published: Counter[str] = Counter()
        for child in self.children:
            summary = child.summary or {}
            published.update(summary.get("published"))
            if child.part == "body" and "robot" in summary:
                of_robots = summary["robot"]["published"]
                published.update({key: count for key, count in of_robots.items() if key in truths})
        if any(child.summary is None for child in self.replaced):
            published.pop(POSITION.key(self.mission.leader), None)
        return sum(count - recorded.get(key, 0) for key, count in published.items())

    @property
    def exit_code(self) -> int:
        """0 if the formation converged and every process ended well, else 1."""
        return 0 if self.converged and not self.faults else 1

    def as_json(self) -> dict[str, Any]:
        """Return the result for a script."""
        return {
            "mission": self.mission.name,
            "law": self.mission.law.kind,
            "robots": len(self.mission.names),
            "converged": self.converged,
            "formation_error": self.monitor.get("formation_error"),
            "known": self.monitor.get("known"),
            "settling_time": self.monitor.get("settling_time"),
            "duration": round(self.duration, 3),
            "interrupted": self.interrupted,
            "recording": self.monitor.get("recording"),
            "recorded": _total(self.monitor, "recorded"),
            "lost": self.lost,
            "processes": {child.name: _account(child) for child in self.children},
        }

    def words(self) -> str:
        """Return the summary for people."""
        verdict = "converged" if self.converged else "not converged"
        if not self.converged and (known := self._known) is not None:
            verdict = f"{'converged' if known[0].converged else 'not converged'} over {known[1].words}"
        when = f", interrupted after {self.duration:.1f} s" if self.interrupted else ""
        rows = [f"{self.mission.name}, {self.mission.law.kind} law: {verdict}{when}"]
        rows += [f"  {title:<17}{text}" for title, text in self._rows()]
        return "\n".join(rows)

    def _rows(self) -> Iterator[tuple[str, str]]:
        if self.monitor:
            yield "formation error", self._error()
            yield "recording", str(self.monitor.get("recording"))
            yield "messages", f"{_total(self.monitor, 'recorded')} recorded, {self.lost or 'none'} lost"
            if recording := self.monitor.get("recording"):
                yield "its figures", f"formation report {shlex.quote(str(recording))}"
        elif self.record is not None and self.record.exists():
            yield "recording", f"{self.record}, cut; formation report and replay read it as far as it goes"
        well = "" if self.faults or self.replaced else ", all ended as they should"
        yield "processes", f"{len(self.children)}{well}"
        for child in self.replaced:
            yield "", f"{child.name} {how_it_ended(child)} during the run; another stood by to lead"
        yield from (("", fault) for fault in self.faults)
        if self.faults:
            yield "logs", str(self.logs)

    @property
    def _known(self) -> tuple[KnownVerdict, KnownError] | None:
        """Return the monitor's verdict on the known edges; None if all were known at the end, or none."""
        found = self.monitor.get("known")
        if self.monitor.get("formation_error") is not None or found is None:
            return None
        verdict = KnownVerdict.of_json(found)
        return None if verdict.final is None or verdict.final.error is None else (verdict, verdict.final)

    def _error(self) -> str:
        error, known = self.monitor.get("formation_error"), self._known
        if known is not None:
            verdict, final = known
            since = self._since(verdict.settled_at, converged=verdict.converged)
            return f"{metres(final.error)}, sum over {final.words}; {since}"
        if error is None:
            return "not known"
        edges = sum(len(robot.neighbours) for robot in self.mission.robots.values())
        since = self._since(self.monitor.get("settled_at"), converged=self.converged)
        return f"{metres(error)}, sum over {edges} edges; {since}"

    def _since(self, settled: float | None, *, converged: bool) -> str:
        """Return since when the error is under the bound, and what is missing for convergence."""
        under = metres(self.mission.settled)
        if settled is None:
            return f"not settled (bound {under})"
        lacking = "" if converged else f"; converged means under it for at least {DWELL_TIME:g} s"
        return f"under {under} since {settled:.1f} s{lacking}"


def ended_well(child: Child) -> bool:
    """Return whether a child ended as requested; one stopped before it was ready may end in any way."""
    return not child.died and (child.exit == 0 or (child.exit == -signal.SIGTERM and not child.ready))


def how_it_ended(child: Child) -> str:
    """Return the end of a sentence about how a child has ended, or that it has not."""
    code = child.exit
    if code is None:
        return "is still alive"
    if code < 0:
        known = {number.value for number in signal.Signals}
        name = signal.Signals(-code).name if -code in known else f"signal {-code}"
        return f"was killed ({name})" if child.died else f"had to be killed ({name})"
    return f"ended with exit code {code}"


def _total(summary: Mapping[str, Any] | None, key: str) -> int | None:
    """Return the sum of the counts in a process's summary; None if it has none."""
    counts = (summary or {}).get(key)
    return None if counts is None else sum(counts.values())


def _account(child: Child) -> dict[str, Any]:
    summary = child.summary or {}
    return {
        "pid": child.pid,
        "exit": child.exit,
        "died": child.died,
        "published": _total(summary, "published"),
        "received": _total(summary, "received"),
        "dropped": _total(summary, "dropped"),
        "robot": {name: _total(summary.get("robot"), name) for name in ("published", "received")},
    }
