"""Chains, parameters and gains in Markdown."""

from __future__ import annotations

from tests.campaigns.bench.control_parameters import front
from tests.campaigns.bench.report_words import Found, centimetres, percent, times
from tests.campaigns.figures import markdown

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
0.1 m/s (u_max 0.22 m/s, L 5 cm, k_I 0.2). Nobody hears those behind, so it is every shorter chain as well.
Each robot's distance from its slot, RMS over the last third of 240 s; and the last robot's over the first's.

{markdown(["hops from the leader", *(str(hop) for hop in hops), "last ÷ first"], rows)}"""


def parameters(found: Found) -> str:
    """Sets of parameters that no other beats."""
    bound, runs = found["bound"], found["runs"]
    best = [("**shipped**", found["tried"][0])]
    best += [(_words(one["parameters"]), one) for one in front(found["tried"])]
    cells = [(name, one["calm"], centimetres(one["rough"]["rms"])) for name, one in best]
    cells += [
        (f"all measuring the leader, k_p {float(gain):g}", one, "") for gain, one in found["star"].items()
    ]
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
Where the rest goes: a robot follows neighbours who are on their way themselves; and saturation acts on each
axis of the body by itself, so with a higher gain it drives at full speed before it points where it should.
"""


def _words(parameters: Found) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in parameters.items()) or "shipped"


def peer_gains(found: Found) -> str:
    """What the proportional law makes of other gains."""
    rows = [
        [
            f"{float(gain):g}",
            percent(one["calm"]["share"]),
            *times(one["calm"], "median"),
            centimetres(one["calm"]["rms"]),
            centimetres(one["late"]["rms"]),
        ]
        for gain, one in found.items()
    ]
    header = ["gain [1/s]", "settle", "median", "error that remains", "samples 100 ms old"]
    return f"### The proportional law's gain\n\n{markdown(header, rows)}"
