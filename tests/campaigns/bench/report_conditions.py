"""Delay, loss, noise, steps and saturation in Markdown."""

from __future__ import annotations

from formation.control.tracker import MAX_DELAY
from tests.campaigns.bench.report_words import Found, centimetres, percent, times
from tests.campaigns.figures import markdown

UNITS = {"delay": (1000.0, "ms old"), "loss": (100.0, "% lost"), "noise": (1000.0, "mm of noise")}


def conditions(found: Found) -> str:
    """What every law makes of each condition."""
    perfect, steps = found["noise"]["0.0"], found["steps"]
    laws = list(perfect)
    rows = [_row("perfect", perfect, laws)]
    for kind, (scale, unit) in UNITS.items():
        rows += [
            _row(f"{scale * float(value):g} {unit}", cells, laws)
            for value, cells in found[kind].items()
            if float(value) > 0.0
        ]
    rows.append(_row("commands cut to 0.01", steps, laws))
    rows.append(_row("– with error feedback", {laws[0]: steps["field law, error feedback"]}, laws))
    return f"""### Delay, loss, noise, steps

![Error that remains under delay, loss and noise](figures/bench_control_conditions.svg)

Median settling, – where under half settle, and the error that remains: RMS of all edges in the second half,
median of the starts. *Gentle* is the field law with a velocity filter of 0.5 s and an observer gain of 2 1/m.

{markdown(["", *laws], rows)}
A sample is carried forward by as much of its age as can be believed: all of its way up to
{MAX_DELAY:g} s, then less and less, nothing from {2.0 * MAX_DELAY:g} s on. Every hop lags by
its speed times what is left of the age, with the paper's law times all of it. Noise is white and new in each
sample, fifty times a second. The field law takes its neighbours' velocities from differences of positions, so
strong noise reaches it where it does not reach the paper's law.
"""


def _row(label: str, cells: Found, laws: list[str]) -> list[str]:
    texts = []
    for law in laws:
        if law not in cells:
            texts.append("")
            continue
        texts.append(f"{times(cells[law], 'median')[0]}, {centimetres(cells[law]['rms'])}")
    return [label, *texts]


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
        rows.append(cells)
    field = ["field: settle", "median / p95", "rate"]
    header = ["u_max ÷ leader", "bound", *field, "paper: settle", *field[1:]]
    return f"""### What saturation costs

![Settling and rate of convergence over saturation](figures/bench_control_saturation.svg)

The question that the paper leaves open: the same robots and starts behind faster and faster leaders. The
bound is the one by body. *Rate* is the median of ln(first error ÷ 5 cm) ÷ settling time. Times and rates are
of the starts that settle within what is said.

{markdown(header, rows)}"""
