"""All defects, by name."""

from __future__ import annotations

from collections.abc import Mapping

from tests.campaigns.defects.catalogue import (
    collisions,
    control,
    election,
    leading,
    orders,
    persistence,
    safety,
    sensing,
    watching,
)
from tests.campaigns.defects.defect import Defect

PARTS = (safety, orders, persistence, collisions, control, sensing, election, leading, watching)
DEFECTS: Mapping[str, Defect] = {one.name: one for part in PARTS for one in part.DEFECTS}
