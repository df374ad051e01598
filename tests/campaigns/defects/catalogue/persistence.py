"""Defects of what agents save and restore."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

RESTORE, STORE, STATE = (
    "agent/persistence/restore.py",
    "agent/persistence/store.py",
    "agent/persistence/state.py",
)

DEFECTS = (
    Defect(
        "stop-not-restored",
        RESTORE,
        'stop = (stops.stop or drawn) if stops.mode == "stop" else ""',
        'stop = (stops.stop or drawn) if stops.holding else ""',
        "a stop ends with the agent",
        ("power",),
    ),
    Defect(
        "vote-not-restored",
        RESTORE,
        'return self._taken(Restored(voted_term=saved.voted_term), "")',
        'return self._taken(Restored(), "")',
        "a restarted agent forgets for whom it has voted",
        ("crashed", "power", "votes"),
    ),
    Defect(
        "old-integral-restored",
        RESTORE,
        "integral = saved.integral if age <= MAX_INTEGRAL_AGE else None",
        "integral = saved.integral",
        "a restarted robot pushes in an old direction",
        ("paper", "crashed"),
    ),
    Defect(
        "pose-not-restored",
        STATE,
        "here=self.here or now.here,",
        "here=now.here,",
        "odometry that counts from the start is placed at the start again",
        ("pair",),
    ),
    Defect(
        "stops-file-not-atomic",
        STORE,
        'fresh = self.stops.with_suffix(".new")',
        "fresh = self.stops",
        "a power cut leaves half a stop",
        ("stopkill",),
    ),
    Defect(
        "checksum-unchecked",
        STORE,
        'if checksum != b"%08x" % crc32(text):',
        "if not checksum:",
        "half written state is read",
        ("torn",),
    ),
    Defect(
        "unsaved-stop-acknowledged",
        RESTORE,
        "return self._store.written(MAX_SAVE_WAIT)",
        "return True",
        "an operator is not told that a stop is not saved",
        ("full", "power"),
    ),
)
