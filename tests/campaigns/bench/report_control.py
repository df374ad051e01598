"""The figures of `bench_control` in Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from formation.control.tracker import MAX_DELAY
from tests.campaigns.bench.control_trials import GENTLE, SHIPPED, front
from tests.campaigns.figures import judged, markdown

Found = Mapping[str, Any]


def times(one: Found, *which: str, digits: int = 1) -> list[str]:
    """Settling times; – where too few settle."""
    settling = [one["settling"][key] for key in which]
    return ["–" if time is None else f"{time:.{digits}f} s" for time in settling]


def percent(share: float) -> str:
    """Nothing that is not 100 % is written as if it were."""
    return f"{100.0 * share:.{0 if share in {0.0, 1.0} else 1}f} %"


def centimetres(metres: float) -> str:
    """Three digits; a run that ran away has no number worth telling."""
    value = 100.0 * metres
    if value > 1000.0:
        return "> 10 m"
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f} cm"


def section(found: Found) -> str:
    """All of it."""
    sections = {
        "laws": laws, "convergence": convergence, "routes": on_routes, "conditions": conditions,
        "saturation": saturation, "chains": chains, "parameters": parameters, "peer gains": peer_gains,
    }  # fmt: skip
    return "\n".join([bars(found), *(write(found[name]) for name, write in sections.items())])


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
under 5 cm until the end of the run, and for at least 10 s. The collision filter is off but where a row says
that it is on: no other law has one, and bodies go through each other.

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

**Lower bound by distance**: no run has settled before the last robot is within 5 cm of where its slot is by
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
    rows = []
    for route, case in found.items():
        for name, one in case["laws"].items():
            middle = one["settling"]["median"]
            of_bound = "–" if middle is None else f"{middle / case['bound']:.1f}×"
            left = (centimetres(one["peak"]), centimetres(one["rms"]))
            rows.append([f"{route}: {name}", percent(one["share"]), *times(one, "median"), of_bound, *left])
    header = ["", "settle", "median", "of the bound", "peak", "RMS"]
    return f"""### On other routes

The leader at 0.2 m/s; *settled* is here the first time under 5 cm for 10 s on end. Peak and RMS are of the
error of all edges between 45 and 90 s, medians of the starts, all of it looked at every 80 ms. At 50 and
75 s the leader of the square turns a corner on the spot, which no robot can follow at once.

{markdown(header, rows)}"""


UNITS = {"delay": (1000.0, "ms old"), "loss": (100.0, "% lost"), "noise": (1000.0, "mm of noise")}


def conditions(found: Found) -> str:
    """What every law makes of each condition."""
    perfect, steps = found["noise"]["0.0"], found["steps"]
    laws = list(perfect)
    rows = [_row("perfect", perfect, laws)]
    for kind, (scale, unit) in UNITS.items():
        worse = [(value, cells) for value, cells in found[kind].items() if float(value) > 0.0]
        rows += [_row(f"{scale * float(value):g} {unit}", cells, laws) for value, cells in worse]
    rows.append(_row("commands cut to 0.01", steps, laws))
    rows.append(_row("– with error feedback", {laws[0]: steps["field law, error feedback"]}, laws))
    return f"""### Delay, loss, noise, steps

![Error that remains under delay, loss and noise](figures/bench_control_conditions.svg)

Median settling, – where under half settle, and the error that remains: RMS of all edges in the second half,
median of the starts. *Gentle* is the field law with {_words(GENTLE.parameters)}.

{markdown(["", *laws], rows)}
A sample is carried forward by as much of its age as can be believed: all of its way up to
{MAX_DELAY:g} s, then less and less, nothing from {2.0 * MAX_DELAY:g} s on. Every hop lags by
its speed times what is left of the age, with the paper's law times all of it. Noise is white and new in each
sample, fifty times a second.
"""


def _row(label: str, cells: Found, laws: list[str]) -> list[str]:
    some = [cells.get(law) for law in laws]
    return [label, *(f"{times(one, 'median')[0]}, {centimetres(one['rms'])}" if one else "" for one in some)]


def saturation(found: Found) -> str:
    """Share, settling and rate of both laws over saturation."""
    rows = []
    for ratio, one in found.items():
        cells = [f"{ratio}", f"{one['bound'][10]:.1f} s"]
        for name in ("field law", "paper's law"):
            law = one[name]
            share = f"{percent(law['share'])} in {one['horizon'][name]:.0f} s"
            rate = f"{law['rate'][1]:.2f} 1/s" if law["rate"] else "–"
            cells += [share, " / ".join(times(law, "median", "p95")), rate]
        shipped = one[SHIPPED.name]
        rows.append([*cells, percent(shipped["share"]), " / ".join(times(shipped, "median", "p95"))])
    field = ["field: settle", "median / p95", "rate"]
    header = ["u_max ÷ leader", "bound", *field, "paper: settle", *field[1:], "with filter: settle", field[1]]
    return f"""### What saturation costs

![Settling and rate of convergence over saturation](figures/bench_control_saturation.svg)

The question that the paper leaves open: the same robots and starts behind faster and faster leaders. The
bound is the one by body. *Rate* is the median of ln(first error ÷ 5 cm) ÷ settling time. Times and rates are
of the starts that settle within what is said. *With filter* is the field law as shipped, for as long: the
faster robots drive, the more room the filter keeps ahead of each. A start settles if the error is
under the bound in the last 10 s of the run.

{markdown(header, rows)}"""


HOPS = (1, 5, 12, 25, 50)


def chains(found: Found) -> str:
    """How the error grows along a chain."""
    deepest = len(next(iter(found.values())))
    hops = [hop for hop in HOPS if hop <= deepest]
    rows = [
        [name, *(centimetres(errors[hop - 1]) for hop in hops), f"{errors[-1] / errors[0]:,.0f}×"]
        for name, errors in found.items()
    ]
    return f"""### Along a chain

![Distance from the slot along a chain](figures/bench_control_chain.svg)

{deepest} robots half a metre apart, each measuring the one before it, behind a leader on a circle of 1 m at
0.1 m/s (u_max 0.22 m/s, L 5 cm, k_I 0.2). No robot receives those behind, so it is every shorter chain as
well. Each robot's distance from its slot, RMS over the last third of 240 s; and the last robot's over the
first's.

{markdown(["hops from the leader", *(str(hop) for hop in hops), "last ÷ first"], rows)}"""


def parameters(found: Found) -> str:
    """Sets of parameters that no other beats."""
    bound, runs = found["bound"], found["runs"]
    best = [("**shipped**", found["tried"][0])]
    best += [(_words(one["parameters"]), one) for one in front(found["tried"]) if one["parameters"]]
    cells = [(name, one["calm"], centimetres(one["rough"]["rms"])) for name, one in best]
    star = found["star"].items()
    cells += [(f"all measuring the leader, gain {float(gain):g}", one, "") for gain, one in star]
    rows = [
        [name, *times(calm, "median", "p95"), f"{calm['settling']['median'] / bound:.2f}×", rough]
        for name, calm, rough in cells
    ]
    header = [f"{runs} starts", "median", "p95", "of the bound", "left in a rough world"]
    return f"""### What the parameters are worth

![Settling against the error in a rough world](figures/bench_control_parameters.svg)

{len(found["tried"])} sets of the field law's parameters, each the same for all starts. In the rough world
samples are 100 ms old and positions have 5 mm of noise; there the RMS of the error counts. Shown are those
that no other beats in both, and the same law when every robot measures the leader instead of its neighbours.

{markdown(header, rows)}
What remains above the bound: neighbours are still moving to their slots, and the robot must turn first.
"""


def _words(parameters: Found) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in parameters.items()) or "shipped"


def peer_gains(found: Found) -> str:
    """What the proportional law makes of other gains."""
    rows = []
    for gain, one in found.items():
        calm, left = one["calm"], [centimetres(one[kind]["rms"]) for kind in ("calm", "late")]
        rows.append([f"{float(gain):g}", percent(calm["share"]), *times(calm, "median"), *left])
    header = ["gain [1/s]", "settle", "median", "error that remains", "samples 100 ms old"]
    return f"### The proportional law's gain\n\n{markdown(header, rows)}"
