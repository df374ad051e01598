"""Format quantities for a report. An unknown value is a dash."""

from __future__ import annotations

import math

UNKNOWN = "–"


def length(value: float | None) -> str:
    """Return a length [m], to three digits: 13.9 m, 4.26 cm, 0.25 mm, 1.10 µm."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    for least, factor, unit in ((0.9995, 1.0, "m"), (0.009995, 1e2, "cm"), (9.995e-5, 1e3, "mm")):
        if abs(value) >= least:
            return f"{_three(value * factor)} {unit}"
    return f"{_three(value * 1e6)} µm" if value else "0 m"


def bound(value: float) -> str:
    """Return a chosen length [m]: 5 cm."""
    return f"{value * 1e2:g} cm" if value < 1.0 else f"{value:g} m"


def seconds(value: float | None) -> str:
    """Return a time in a run [s]: 3.60 s."""
    return UNKNOWN if value is None or not math.isfinite(value) else _signed(f"{value:.2f} s")


def lasting(value: float | None) -> str:
    """Return a duration [s]: 31.4 s, 12 min 5 s, 1 h 2 min."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if value < 99.95:
        return f"{value:.1f} s"
    minutes, rest = divmod(round(value), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def milliseconds(value: float | None) -> str:
    """Return a delay [s]: 0.64 ms, 54.3 ms, 12.3 s."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return f"{_three(value * 1e3)} ms" if abs(value) < 0.9995 else f"{_three(value)} s"


def degrees(value: float | None) -> str:
    """Return an angle [rad], in degrees: 3.83°."""
    return UNKNOWN if value is None or not math.isfinite(value) else f"{_three(math.degrees(value))}°"


def share(value: float | None) -> str:
    """Return a share of 1: 4.2 %."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    return "0 %" if value == 0.0 else "<0.1 %" if value < 0.0005 else f"{value * 100:.1f} %"


def rate(value: float | None) -> str:
    """Return messages per second: 20.0 Hz."""
    return UNKNOWN if value is None or not math.isfinite(value) else f"{value:.1f} Hz"


def whole(value: float | None) -> str:
    """Return a count: 13,798."""
    return UNKNOWN if value is None else f"{value:,.0f}"


def size(value: int) -> str:
    """Return a size [bytes]: 1.9 MB."""
    for factor, unit in ((1e9, "GB"), (1e6, "MB"), (1e3, "kB")):
        if value >= 0.99995 * factor:
            return f"{value / factor:.1f} {unit}"
    return f"{value} bytes"


def ratio(value: float | None) -> str:
    """Return a ratio: × 7.72."""
    if value is None or not math.isfinite(value):
        return UNKNOWN
    if 0.0 < value < 0.0995:
        return f"× {value:.3f}" if value >= 0.0005 else "× <0.001"
    return f"× {_three(value)}" if value < 999.5 else f"× {value:,.0f}"


def _three(value: float) -> str:
    """Return three significant digits, at most two decimals, never an exponent."""
    if 0.0 < abs(value) < 0.005:
        return "<0.01"
    places = min(max(2 - math.floor(math.log10(abs(value))), 0), 2) if value else 0
    return _signed(f"{value:.{places}f}")


def _signed(text: str) -> str:
    return text.replace("-", "−")
