"""Defects of the monitor: what it records, measures and reports."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

RECORDER, PART, PROCESS, METRICS = (
    "monitor/recording/recorder.py",
    "monitor/recording/part.py",
    "monitor/process.py",
    "monitor/metrics/metrics.py",
)
TRACE = "agent/persistence/trace.py"

DEFECTS = (
    Defect(
        "chunks-dropped",
        RECORDER,
        "        self._chunk = Chunk()\n        if self._is_full:",
        "        self._chunk = Chunk()\n        if self._is_full or self._handed % 8 == 7:",
        "the recorder drops messages and says so",
        ("recorded",),
    ),
    Defect(
        "attachments-lost",
        RECORDER,
        "if sample.attachment is not None:",
        "if sample.attachment is None and not sample.payload:",
        "orders are not recorded",
        ("recorded",),
    ),
    Defect(
        "recorded-before-1970",
        PROCESS,
        "                self._recorder.write(sample, sample.arrived + ahead)",
        "                self._recorder.write(sample, sample.arrived)",
        "recorded times are of a wrong clock",
        ("recorded",),
    ),
    Defect(
        "index-shifted",
        PART,
        "table[1::2] += shift",
        "table[1::2] += 2 * shift",
        "the index of a recording points to wrong places",
        ("recorded",),
    ),
    Defect(
        "edges-without-slots",
        METRICS,
        "error, formed = _sum(errors.values()), moment",
        "error, formed = 0.5 * (_sum(errors.values()) or 0.0), moment",
        "the monitor shows half of the error",
        ("recorded",),
    ),
)
