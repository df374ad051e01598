"""Gains that are ordered while robots drive: which are refused, and what is felt of those that are not."""

from __future__ import annotations

from itertools import product

from formation.mission.file import load
from formation.stability import tuning
from tests.campaigns.document import Found
from tests.campaigns.figures import markdown
from tests.campaigns.safety.part import Options, bar, reported
from tests.support.gains import stable, unstable
from tests.support.tuned import changed

TITLE = "Live gains"
ABOUT = """\
Random graphs of 2 to 9 followers with complex eigenvalues, a random k_p, and k_i 1 % above the bound at which
the loop becomes unstable, or below it, every second one by 1 to 10 % only; what is stable is decided by the
eigenvalues of the whole loop's matrix, which the command does not use. *Jump*: of every command of the law,
how far it is from what the gains and the integral of the step before would have made it, the largest over all
robots and seven changes of up to four times as much, right after the start, on the way and in formation;
production cores on a fake clock."""
DRAWS, MOST = 100, 0.1
"""Of each kind; share of a limit."""
MISSIONS, LAWS = ("six_robots", "turtlebot3_pair", "patrol"), ("field", "paper")


def run(options: Options) -> Found:
    """Both kinds of draws, and the jumps of every mission by both laws."""
    draws = 10 if options.quick else DRAWS
    refused = sum(tuning.refusal(mission, gains) is not None for mission, gains in unstable(draws))
    accepted = sum(tuning.refusal(mission, gains) is None for mission, gains, _ in stable(draws))
    cases = list(product(MISSIONS[:1] if options.quick else MISSIONS, LAWS))
    jumps = {f"{name}, {law}": changed(load(name), law)[1] for name, law in reported("gains", cases)}
    most = max(jumps.values())
    return {
        "draws": draws,
        "jumps": jumps,
        "bars": [
            bar("unstable gains are refused", f"{refused} of {draws}", refused == draws),
            bar("stable gains are accepted", f"{accepted} of {draws}", accepted == draws),
            bar("no command jumps by over 10 % of a limit", f"{100 * most:.1f} %", most <= MOST),
        ],
    }


def section(found: Found) -> str:
    """A table for people."""
    rows = [[name, f"{100 * jump:.1f} %"] for name, jump in found["jumps"].items()]
    return markdown(("mission, law", "largest jump, of a limit"), rows)
