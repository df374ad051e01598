"""Range scans on the wire: scans of real scanners are decoded, impossible ones refused."""

from __future__ import annotations

import math
import tracemalloc
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from formation.ros2.laser_scan import MAX_BEAMS
from formation.ros2.messages import BadMessage, LaserScan, decode, encode
from tests.unit.formation import by_rosbags
from tests.unit.formation.examples import NOW

DEGREE = math.radians(1.0)
SCAN = LaserScan(NOW, 0.0, DEGREE, 0.12, 3.5, (1.0,) * 360, scan_time=0.2)
LDS_01 = {
    "angle_min": 0.0,
    "angle_max": 2.0 * math.pi,
    "angle_increment": DEGREE,
    "time_increment": 0.2 / 360,
    "scan_time": 0.0,
    "range_min": 0.12,
    "range_max": 3.5,
}


def as_sent(little_endian: bool = True, **fields: Any) -> bytes:
    """The payload of an LDS-01's driver, with `fields` replaced."""
    ranges = np.array(fields.pop("ranges", [1.0] * 360), np.float32)
    intensities = np.array(fields.pop("intensities", [50.0] * len(ranges)), np.float32)
    header, numbers = by_rosbags.header(NOW, "base_scan"), (LDS_01 | fields).values()
    raw = by_rosbags.make(LaserScan.ROS_TYPE, header, *numbers, ranges, intensities)
    return bytes(by_rosbags.STORE.serialize_cdr(raw, LaserScan.ROS_TYPE, little_endian=little_endian))


@pytest.mark.parametrize("little_endian", [True, False])
def test_lds_01_scan_is_decoded(little_endian: bool) -> None:
    scan = decode(LaserScan, as_sent(little_endian, ranges=[0.0, 1.25, *[2.5] * 358]))
    assert (scan.stamp, scan.frame) == (NOW, "base_scan")
    assert scan.ranges[:3] == (0.0, 1.25, 2.5)
    assert len(scan.ranges) == 360
    assert scan.angle_increment == pytest.approx(DEGREE, rel=1e-6)
    assert (scan.range_min, scan.range_max) == pytest.approx((0.12, 3.5))


def test_scans_of_clockwise_and_sector_scanners_are_decoded() -> None:
    clockwise = as_sent(angle_max=-359 * DEGREE, angle_increment=-DEGREE)
    assert decode(LaserScan, clockwise).angle_increment == pytest.approx(-DEGREE)
    sector = as_sent(angle_min=-2.0, angle_max=2.0, angle_increment=0.004, ranges=[1.0] * 1001)
    assert len(decode(LaserScan, sector).ranges) == 1001


def test_scan_with_beams_without_range_is_decoded() -> None:
    scan = decode(LaserScan, as_sent(ranges=[math.inf, math.nan, -math.inf, 0.0, -1.0, 1e30], intensities=[]))
    assert scan.ranges[:5] == (math.inf, math.inf, -math.inf, 0.0, -1.0)
    assert scan.ranges[5] == pytest.approx(1e30)


@pytest.mark.parametrize(
    ("field", "number", "reason"),
    [
        *[(field, number, "") for field in LDS_01 for number in (math.nan, math.inf, -math.inf)],
        ("angle_increment", 0.0, "angle increment is 0"),
        ("angle_increment", 1e-6, "angle increment"),
        ("angle_increment", 2 * DEGREE, "one full turn"),
        ("angle_min", 100.0, "angle is 100"),
        ("time_increment", -1e-4, "time of a beam"),
        ("scan_time", 100.0, "time of a beam or a scan"),
        ("range_min", -0.1, "ranges from -0.1"),
        ("range_min", 3.5, "must rise"),
        ("range_max", 0.1, "must rise"),
        ("range_max", 1e4, "must rise"),
        ("ranges", [], "0 beams"),
        ("ranges", [1.0] * (MAX_BEAMS + 1), f"from 1 to {MAX_BEAMS}"),
        ("intensities", [1.0] * 359, "359 intensities"),
    ],
)
def test_scan_with_impossible_field_is_refused(field: str, number: Any, reason: str) -> None:
    fields = {field: number}
    if field == "ranges":
        fields |= {"intensities": [], "angle_increment": 0.001}
    with pytest.raises(BadMessage, match=f"LaserScan: .*{reason}"):
        decode(LaserScan, as_sent(**fields))


@pytest.mark.parametrize(
    "change",
    [
        {"angle_increment": 0.0},
        {"angle_increment": 1e-60},
        {"angle_min": math.nan},
        {"range_max": 0.12},
        {"range_min": 3.4999999999},  # the same number in single precision
        {"ranges": ()},
        {"ranges": (1e39,)},
        {"ranges": (1.0,) * 400},
        {"scan_time": -1.0},
    ],
)
def test_encode_refuses_unreadable_scan(change: dict[str, Any]) -> None:
    with pytest.raises(BadMessage):
        encode(replace(SCAN, **change))


@pytest.mark.parametrize("count", [MAX_BEAMS + 1, 2**16, 2**31, 2**32 - 1])
def test_wrong_beam_count_is_refused_without_allocating(count: int) -> None:
    payload = encode(SCAN)
    at = payload.index((360).to_bytes(4, "little"))
    tracemalloc.start()
    try:
        with pytest.raises(BadMessage, match="beams"):
            decode(LaserScan, payload[:at] + count.to_bytes(4, "little") + payload[at + 4 :])
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 100_000


def test_scan_with_max_beams_is_decoded() -> None:
    finest = replace(SCAN, angle_increment=2.0 * math.pi / MAX_BEAMS, ranges=(1.0,) * MAX_BEAMS)
    assert decode(LaserScan, encode(finest)).ranges == finest.ranges
