"""How figures of the control benchmarks are written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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
