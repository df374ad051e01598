"""The figures of `bench_control` in Markdown."""

from __future__ import annotations

from typing import Any

from tests.campaigns.bench.report_conditions import conditions, saturation
from tests.campaigns.bench.report_parameters import chains, parameters, peer_gains
from tests.campaigns.bench.report_words import Found, centimetres, percent, times
from tests.campaigns.figures import judged, markdown


def section(found: Found) -> str:
    """All of it."""
    return "\n".join(
        (
            bars(found),
            laws(found["laws"]),
            convergence(found["convergence"]),
            on_routes(found["routes"]),
            conditions(found["conditions"]),
            saturation(found["saturation"]),
            chains(found["chains"]),
            parameters(found["parameters"]),
            peer_gains(found["peer gains"]),
        )
    )


def bars(found: Found) -> str:
    """What the figures were to come to."""
    by_law, deep = found["laws"]["found"], found["chains"]
    field, paper = (by_law[name]["settling"]["median"] for name in ("field law", "paper's law"))
    gain, over = paper / field, field / found["laws"]["bounds"]["by distance"][10]
    tail, late = (100.0 * deep[name][11] for name in ("field law", "field law, 100 ms"))
    rows: list[tuple[str, str, str, bool | None]] = [
        ("median settling, paper's law ÷ field law", f"{gain:.1f}×", "≥ 6×", gain >= 6.0),
        ("median settling, field law ÷ lower bound", f"{over:.2f}×", "≤ 2×", over <= 2.0),
        *(
            (f"settle of {one['runs']:,} starts, {name}", percent(one["share"]), "100 %", one["share"] == 1.0)
            for name, one in found["convergence"].items()
        ),
        ("twelfth of a chain, circle of 1 m at 0.1 m/s", f"{tail:.2f} cm", "< 1 cm", tail < 1.0),
        ("the same, samples 100 ms old", f"{late:.2f} cm", "< 2 cm", late < 2.0),
    ]
    return f"""Same starts, limits, simulated robots and links for all laws; the machine does not matter.
Unless said: the shipped six robots with ideal bodies, control points starting within ± 3 m of their slots on
each axis, headings at random, steps of 20 ms. *Settled* is a formation error, summed over the nine edges, of
under 5 cm until the end of the run, and for at least 10 s.

{judged(rows)}"""


def laws(found: Found) -> str:
    """Laws from the same starts, and the least that any could take."""
    rows = []
    for name, one in found["found"].items():
        of_bound = f"{one['of the bound']:.2f}×" if one["of the bound"] else "–"
        timed = times(one, "median", "p95", "max", digits=2)
        rows.append([name, percent(one["share"]), *timed, of_bound, centimetres(one["rms"])])
    for name, bound in found["bounds"].items():
        timed = [f"{bound[index]:.2f} s" for index in (10, 19, 20)]
        rows.append([f"lower bound, {name}", "", *timed, "", ""])
    runs = found["found"]["field law"]["runs"]
    header = [f"{runs:,} starts", "settle", "median", "p95", "last", "of the bound", "error that remains"]
    return f"""### The laws, and the least that any could take

![Error over time, and the share of starts that have settled](figures/bench_control_time.svg)

{markdown(header, rows)}
On the left the median of all starts and the middle half of them. *Of the bound* is the median of each start's
own ratio to the bound by distance.

**Lower bound by distance**: nobody has settled before the last robot is within 5 cm of where its slot is by
then, and no control point is faster than hypot(u_max, L ω_max). It is a true bound, for a robot's distance
from its slot is at most the sum of the errors on a path of edges to the leader. **By body** is the same for
robots that are driven by u_max and ω_max from the heading they start with. Both bounds know all positions and
headings from the start; the laws have to find out their own heading and how fast their neighbours are.

The **proportional** laws are after the public examples of the Robotarium: consensus with the desired
displacements, at three quarters of the top speed at most, through the near-identity mapping, and once through
the one that turns first. Gain 10 is that of the examples, gain 40 the best of those below for a perfect
network at 50 Hz. They have no integral and no feed-forward: every robot keeps an error of speed ÷ gain.
"""


def convergence(found: Found) -> str:
    """The field law from very many starts."""
    rows = [
        [name, f"{one['runs']:,}", percent(one["share"]), *times(one, "median", "p95", "max")]
        for name, one in found.items()
    ]
    return f"""### Whether it always converges

{markdown(["field law", "starts", "settle", "median", "p95", "last"], rows)}
At 95 % in steps of 50 ms, these robots' own rate, for 150 s.
"""


def on_routes(found: Found) -> str:
    """Every law on every route."""
    rows = [row(route, name, case) for route, case in found.items() for name in case["laws"]]
    header = ["", "settle", "median", "of the bound", "peak", "RMS"]
    return f"""### On other routes

The leader at 0.2 m/s; *settled* is here the first time under 5 cm for 10 s on end. Peak and RMS are of the
error of all edges between 45 and 90 s, medians of the starts, all of it looked at every 80 ms. At 50 and
75 s the leader of the square turns a corner on the spot, which nobody can follow at once.

{markdown(header, rows)}"""


def row(route: str, name: str, case: Any) -> list[str]:
    """One law on one route."""
    one, middle = case["laws"][name], case["laws"][name]["settling"]["median"]
    of_bound = "–" if middle is None else f"{middle / case['bound']:.1f}×"
    remaining = (centimetres(one["peak"]), centimetres(one["rms"]))
    return [f"{route}: {name}", percent(one["share"]), *times(one, "median"), of_bound, *remaining]
