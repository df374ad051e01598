"""Format quantities for people."""

from __future__ import annotations

import math


def metres(value: float | None) -> str:
    """Return a length [m]: 1.23 m, 45 cm, 8 mm, 0.8 mm."""
    if value is None or not math.isfinite(value):
        return "-"
    size = abs(value)
    if size < 5e-5:
        return "0 mm" if size == 0.0 else "<0.1 mm"
    if size < 0.00995:
        return f"{value * 1e3:.1f} mm"
    if size < 0.0995:
        return f"{value * 1e3:.0f} mm"
    return f"{value * 100:.0f} cm" if size < 0.995 else f"{value:.2f} m"


def seconds(value: float | None) -> str:
    """Return a time [s]: 35 ms, 12 s."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value * 1e3:.0f} ms" if value < 0.9995 else f"{value:.0f} s"
