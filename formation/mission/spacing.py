"""Which discs overlap."""

from __future__ import annotations

from collections.abc import Iterator, Sequence


def too_close(centres: Sequence[complex], radii: Sequence[float]) -> Iterator[tuple[int, int, float]]:
    """(i, j, distance [m]) of any discs i < j not further apart than their radii, by j, then by i.

    A sweep along x: only discs within reach are compared, so thousands of them take no time.
    """
    order = sorted(range(len(centres)), key=lambda i: centres[i].real)
    widest = 2.0 * max(radii, default=0.0)
    found = []
    for place, i in enumerate(order):
        for after in range(place + 1, len(order)):
            j = order[after]
            if centres[j].real - centres[i].real > widest:
                break
            distance = abs(centres[j] - centres[i])
            if distance <= radii[i] + radii[j]:
                found.append((max(i, j), min(i, j), distance))
    for j, i, distance in sorted(found):
        yield i, j, distance
