from __future__ import annotations

from collections.abc import Callable

import pytest

from formation.monitor.report import words


@pytest.mark.parametrize(
    ("write", "value", "text"),
    [
        (words.length, 13.87, "13.9 m"),
        (words.length, 0.99951, "1.00 m"),
        (words.length, 0.0426, "4.26 cm"),
        (words.length, 0.00232, "2.32 mm"),
        (words.length, 1.097e-6, "1.10 µm"),
        (words.length, 1e-9, "<0.01 µm"),
        (words.length, 0.0, "0 m"),
        (words.length, None, "–"),
        (words.length, float("nan"), "–"),
        (words.bound, 0.05, "5 cm"),
        (words.bound, 2.5, "2.5 m"),
        (words.seconds, 3.600066, "3.60 s"),
        (words.seconds, -2.5, "−2.50 s"),
        (words.lasting, 34.02, "34.0 s"),
        (words.lasting, 725.0, "12 min 5 s"),
        (words.lasting, 3725.0, "1 h 2 min"),
        (words.milliseconds, 0.00231, "2.31 ms"),
        (words.milliseconds, 12.34, "12.3 s"),
        (words.degrees, 0.0669, "3.83°"),
        (words.share, 0.0, "0 %"),
        (words.share, 0.0001, "<0.1 %"),
        (words.share, 0.449, "44.9 %"),
        (words.rate, 20.012, "20.0 Hz"),
        (words.whole, 13798, "13,798"),
        (words.size, 903_800, "903.8 kB"),
        (words.ratio, 7.72, "× 7.72"),
        (words.ratio, 32253.4, "× 32,253"),
        (words.ratio, 0.0437, "× 0.044"),
        (words.ratio, 0.0001, "× <0.001"),
        (words.ratio, 0.0, "× 0"),
    ],
)
def test_a_quantity_is_written_for_people(
    write: Callable[[float | None], str], value: float, text: str
) -> None:
    assert write(value) == text
