"""The figures of `bench_control` in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tests.bench.control_chains import front
from tests.bench.figures import markdown

Found = Mapping[str, Any]
HOPS = (1, 5, 11, 12, 25, 50)


def section(found: Found) -> str:
    """All of it."""
    return "\n".join(
        (
            _bars(found),
            _laws(found["laws"]),
            _convergence(found["convergence"]),
            _routes(found["routes"]),
            _conditions(found["conditions"]),
            _saturation(found["saturation"]),
            _chains(found["chains"]),
            _parameters(found["parameters"]),
            _peer_gains(found["peer gains"]),
        )
    )


def _bars(found: Found) -> str:
    laws, chains = found["laws"]["found"], found["chains"]
    settled = {name: laws[name]["settling"]["median"] for name in ("field law", "paper's law")}
    gain = settled["paper's law"] / settled["field law"]
    over = settled["field law"] / found["laws"]["bounds"]["by distance"][10]
    tail, late = (100.0 * chains[name][11] for name in ("field law", "field law, 100 ms"))
    rows = [
        ["six robots, median settling: paper's law ÷ field law", f"{gain:.1f}×", "≥ 6×", gain >= 6.0],
        ["field law ÷ lower bound, medians", f"{over:.2f}×", "≤ 2×", over <= 2.0],
        *(
            [
                f"{one['runs']:,} starts that settle, {name}",
                _percent(one["share"]),
                "100 %",
                one["share"] == 1.0,
            ]
            for name, one in found["convergence"].items()
        ),
        ["twelfth of a chain, leader on a circle of 1 m at 0.1 m/s", f"{tail:.2f} cm", "< 1 cm", tail < 1.0],
        ["the same, samples 100 ms old", f"{late:.2f} cm", "< 2 cm", late < 2.0],
    ]
    return f"""Same starts, same limits, same simulated robots for all laws; nothing here depends on the machine. Unless
said: the shipped six robots, ideal bodies, control points starting within ± 3 m of their slots on each axis,
headings anyhow, steps of 20 ms. *Settled* is a formation error, summed over the nine edges, of under 5 cm until the
end, and for at least 10 s.

{markdown(["figure", "today", "target", ""], [[*row[:3], "met" if row[3] else "falls short"] for row in rows])}"""


def _laws(laws: Found) -> str:
    by_distance, by_body = (laws["bounds"][name] for name in ("by distance", "by body"))
    rows = [
        [
            name,
            _percent(one["share"]),
            *_times(one, "median", "p95", "max"),
            f"{one['of the bound']:.2f}×" if one["of the bound"] else "–",
            _centimetres(one["rms"]),
        ]
        for name, one in laws["found"].items()
    ]
    for name, bound in (("lower bound, by distance", by_distance), ("lower bound, by body", by_body)):
        rows.append([name, "", *(f"{bound[index]:.2f} s" for index in (10, 19, 20)), "", ""])
    runs = laws["found"]["field law"]["runs"]
    header = [f"{runs:,} starts", "settle", "median", "p95", "last", "of the bound", "error that remains"]
    return f"""### Four laws and the least that any could take

![Error over time, and the share of starts that have settled](figures/bench_control_time.svg)

{markdown(header, rows)}
*Of the bound* is the median of each start's own ratio. The **lower bound by distance**: nobody can have settled
before the last robot, at the top speed of its control point hypot(u_max, L ω_max) and in any direction, has come within
5 cm of where its slot is by then. It is a true bound: a robot's distance from its slot is at most the sum of the errors
on a path of edges to the leader. **By body** the same, driven by u_max and ω_max from the heading that each start has.
Both know every position and heading from the start; the laws have to find out their heading and their neighbours' speed.

The **proportional** laws are after the public examples of the Robotarium: consensus with the desired displacements, at
three quarters of the top speed at most, by the near-identity mapping, and once with the mapping that turns first. They
have no integral and no feed-forward, so an edge keeps an error of speed / gain.
"""


def _convergence(found: Found) -> str:
    rows = [
        [name, f"{one['runs']:,}", _percent(one["share"]), *_times(one, "median", "p95", "max")]
        for name, one in found.items()
    ]
    header = ["field law", "starts", "settle", "median", "p95", "last"]
    return f"### Does it always converge\n\n{markdown(header, rows)}\nAt 95 % in steps of 50 ms, the robots' own rate.\n"


def _routes(found: Found) -> str:
    rows = [
        [
            f"{route}: {name}",
            _percent(one["share"]),
            *_times(one, "median"),
            f"{one['settling']['median'] / case['bound']:.1f}×" if one["settling"]["median"] else "–",
            _centimetres(one["peak"]),
            _centimetres(one["rms"]),
        ]
        for route, case in found.items()
        for name, one in case["laws"].items()
    ]
    header = ["", "settle", "median", "of the bound", "peak", "RMS"]
    return f"""### On other routes

The leader at 0.2 m/s; here *settled* is under 5 cm for the first 10 s on end. Peak and RMS are of the error of all
edges between 45 and 90 s, medians of the starts; the square has corners at 50 and 75 s, where the leader turns on the spot.

{markdown(header, rows)}"""


def _conditions(found: Found) -> str:
    def cell(one: Found) -> str:
        settled = one["settling"]["median"]
        return f"{'–' if settled is None else f'{settled:.1f} s'}, {_centimetres(one['rms'])}"

    laws = list(found["noise"]["0.0"])
    kinds = (("delay", 1000.0, "ms old"), ("loss", 100.0, "% lost"), ("noise", 1000.0, "mm of noise"))
    rows = []
    for kind, scale, unit in kinds:
        for value, cells in found[kind].items():
            if float(value) == 0.0 and kind != "delay":
                continue
            one = found["noise"]["0.0"] if float(value) == 0.0 else cells
            label = "perfect" if float(value) == 0.0 else f"{scale * float(value):g} {unit}"
            rows.append([label, *(cell(one[law]) if law in one else "" for law in laws)])
    steps = found["steps"]
    rows.append(["commands cut to 0.01", *(cell(steps[law]) if law in steps else "" for law in laws)])
    rows.append(["– with error feedback", cell(steps["field law, error feedback"]), *[""] * (len(laws) - 1)])
    return f"""### Delay, loss, noise, steps

![Error that remains under delay, loss and noise](figures/bench_control_conditions.svg)

Median settling, and the error that remains (RMS of all edges in the second half, median of the starts); – where under half
settle. *Gentle* is the field law with a velocity filter of 0.5 s and an observer gain of 2 1/m.

{markdown(["", *laws], rows)}
A sample is carried forward by its age up to three periods of its sender, 150 ms here; an older one is taken as it is,
and then every hop lags by speed × age, as with the paper's law. Noise is white and new in every sample, 50 a second.
"""


def _saturation(found: Found) -> str:
    rows = []
    for ratio, one in found.items():
        field, paper = one["field law"], one["paper's law"]
        rates = [f"{law['rate'][1]:.2f} 1/s" if law["rate"] else "–" for law in (field, paper)]
        rows.append(
            [
                ratio,
                f"{one['bound'][10]:.1f} s",
                *_times(field, "median", "p95"),
                _percent(field["share"]),
                rates[0],
                *_times(paper, "median", "p95"),
                f"{_percent(paper['share'])} in {one['horizon'][_PAPER]:.0f} s",
                rates[1],
            ]
        )
    header = ["u_max ÷ leader", "bound", "field", "p95", "settle", "rate", "paper", "p95", "settle", "rate"]
    return f"""### What saturation costs

![Settling and rate of convergence over saturation](figures/bench_control_saturation.svg)

The question that the paper leaves open. The same robots and starts behind faster and faster leaders; the bound is the one
by body. *Rate* is ln(first error / 5 cm) / settling time, median of the starts.

{markdown(header, rows)}"""


_PAPER = "paper's law"


def _chains(found: Found) -> str:
    deepest = len(next(iter(found.values())))
    hops = [hop for hop in HOPS if hop <= deepest]
    rows = [
        [name, *(_centimetres(errors[hop - 1]) for hop in hops), f"{_growth(errors):.3f}"]
        for name, errors in found.items()
    ]
    return f"""### Along a chain

![Distance from the slot along a chain](figures/bench_control_chain.svg)

A chain of {deepest} half a metre apart behind a leader on a circle of 1 m at 0.1 m/s (u_max 0.22 m/s, L 5 cm, k_I 0.2); nobody
hears those behind, so it is every shorter chain as well. Each robot's distance from its slot, RMS over the last third of
240 s. *Growth* is by hop, from the second half of the chain.

{markdown(["hops from the leader", *(str(hop) for hop in hops), "growth"], rows)}"""


def _growth(errors: Sequence[float]) -> float:
    """By what factor the error grows with each hop, on average over the deeper half."""
    middle = len(errors) // 2
    return float((errors[-1] / errors[middle]) ** (1.0 / (len(errors) - 1 - middle)))


def _parameters(found: Found) -> str:
    shipped, bound = found["tried"][0], found["bound"]
    chosen = [("shipped", shipped), *((_words(one["parameters"]), one) for one in front(found["tried"]))]
    rows = [
        [
            name,
            *_times(one["calm"], "median", "p95"),
            f"{one['calm']['settling']['median'] / bound:.2f}×",
            _centimetres(one["rough"]["rms"]),
        ]
        for name, one in chosen
    ]
    header = ["", "median", "p95", "of the bound", "in the rough world"]
    return f"""### What the parameters are worth

![Settling against the error in a rough world](figures/bench_control_parameters.svg)

{len(found["tried"])} sets of field-law parameters, each the same for all of {found["runs"]} starts. The rough world has samples that are
100 ms old and positions with 5 mm of noise; there the RMS error counts. Below those that no other beats in both.

{markdown(header, rows)}"""


def _words(parameters: Found) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in parameters.items()) or "shipped"


def _peer_gains(found: Found) -> str:
    rows = [
        [
            f"{float(gain):g}",
            _percent(one["calm"]["share"]),
            *_times(one["calm"], "median"),
            _centimetres(one["calm"]["rms"]),
            _centimetres(one["late"]["rms"]),
        ]
        for gain, one in found.items()
    ]
    header = ["gain", "settle", "median", "error that remains", "the same, samples 100 ms old"]
    return f"""### The proportional law's gain

{markdown(header, rows)}"""


def _times(one: Found, *which: str) -> list[str]:
    times = [one["settling"][key] for key in which]
    return ["–" if time is None else f"{time:.1f} s" for time in times]


def _percent(share: float) -> str:
    return f"{100.0 * share:.{0 if share in {0.0, 1.0} else 1}f} %"


def _centimetres(metres: float) -> str:
    """Three digits; a run that ran away has no number worth telling."""
    value = 100.0 * metres
    if value > 1000.0:
        return "> 10 m"
    return f"{value:.{2 if value < 9.995 else 1 if value < 99.95 else 0}f} cm"
