"""Defects of the law, its integral, limits, ramp, quantiser, observer and tracker."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

FIELD, CONTROLLER, UNICYCLE = (
    "formation/control/laws/field.py",
    "formation/control/controller.py",
    "formation/control/unicycle.py",
)
RAMP, QUANTISER, POSE_FILTER, TRACKER, TRUST = (
    "formation/control/ramp.py",
    "formation/control/quantiser.py",
    "formation/control/pose_filter.py",
    "formation/control/tracker.py",
    "formation/control/trust.py",
)
NEIGHBOURS, GAINS, SLOTS = (
    "agent/following/neighbours.py",
    "agent/following/gains.py",
    "agent/following/slots.py",
)
CORE, COMMANDER, AVAILABLE = "agent/core.py", "agent/safety/commander.py", "agent/following/attachment.py"

DEFECTS = (
    Defect(
        "feed-forward-rotated",
        FIELD,
        "carried = to_body * measured.velocity",
        "carried = heading * measured.velocity",
        "the neighbours' velocity is taken in a wrong frame",
        ("quiet",),
    ),
    Defect(
        "integral-reversed",
        CONTROLLER,
        "+ gains.k_i * to_body * integral",
        "- gains.k_i * to_body * integral",
        "the integral drives the robot away",
        ("quiet",),
    ),
    Defect(
        "closing-beyond-top-speed",
        FIELD,
        "closing = intercepting(towards, carried, closing, limits)",
        "closing = limits.max_speed + speed",
        "a robot drives at full speed before it points to its slot",
        ("quiet",),
    ),
    Defect(
        "trust-reversed",
        TRUST,
        "return 1.0 / (LEAST_EXCESS + excess * excess)",
        "return LEAST_EXCESS + excess * excess",
        "neighbours count more the less they are in formation",
        ("quiet",),
    ),
    Defect(
        "filter-blind-in-reverse",
        POSE_FILTER,
        "heading += p12.conjugate() * (inverse * innovation)",
        "heading -= p12.conjugate() * (inverse * innovation)",
        "a robot learns the opposite heading",
        ("quiet", "crossing"),
    ),
    Defect(
        "speed-not-clipped",
        UNICYCLE,
        "Command(clip(nominal.real, max_speed),",
        "Command(nominal.real,",
        "commands beyond the speed limit",
        ("quiet",),
    ),
    Defect(
        "ramp-unbounded-time",
        RAMP,
        "share = min(silence, most.longest) / most.time",
        "share = silence / most.time",
        "commands leap after a pause",
        ("slow",),
    ),
    Defect(
        "ramp-dropped",
        RAMP,
        "return slewed(ramp.before, wanted, limits, share), until",
        "return wanted, until",
        "commands change at once",
        ("quiet",),
    ),
    Defect(
        "remainder-forgotten",
        QUANTISER,
        "nearest(quantiser.speed, wanted.speed + remainder.speed)",
        "nearest(quantiser.speed, wanted.speed)",
        "slow commands are rounded away",
        ("quiet", "pair"),
    ),
    Defect(
        "extrapolated-backwards",
        TRACKER,
        "return track.point + track.velocity * clip(moment - track.stamp, longest)",
        "return track.point - track.velocity * clip(moment - track.stamp, longest)",
        "neighbours are expected where they were",
        ("bend", "quiet"),
    ),
    Defect(
        "slots-reversed",
        NEIGHBOURS,
        "desired += share * (slots.state.at[name] - mine)",
        "desired += share * (mine - slots.state.at[name])",
        "the formation is mirrored",
        ("quiet",),
    ),
    Defect(
        "slot-velocity-added",
        NEIGHBOURS,
        "carried = one.velocity - slots.state.velocity[name]",
        "carried = one.velocity + slots.state.velocity[name]",
        "robots lag in shapes that turn",
        ("bend", "orders"),
    ),
    Defect(
        "unavailable-for-ever",
        AVAILABLE,
        "self.behind = self.error > FOLLOWING_EDGE_ERROR and moment - self.since < FAULT_FREE_TIME",
        "self.behind = self.error > -FOLLOWING_EDGE_ERROR or moment - self.since < FAULT_FREE_TIME",
        "a robot that had a fault is never followed again",
        ("frozen",),
    ),
    Defect(
        "gains-one-way",
        GAINS,
        "part = most / far",
        "part = -most / far",
        "gains move away from those that are ordered",
        ("orders",),
    ),
)
