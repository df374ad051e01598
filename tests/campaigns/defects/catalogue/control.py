"""Defects of the law, its integral, limits, ramp, quantiser, observer and tracker."""

from __future__ import annotations

from tests.campaigns.defects.defect import Defect

FIELD, CONTROLLER, UNICYCLE = (
    "formation/control/laws/field.py",
    "formation/control/controller.py",
    "formation/control/unicycle.py",
)
RAMP, QUANTISER, OBSERVER, TRACKER = (
    "formation/control/ramp.py",
    "formation/control/quantiser.py",
    "formation/control/observer.py",
    "formation/control/tracker.py",
)
NEIGHBOURS, GAINS, SLOTS = (
    "agent/following/neighbours.py",
    "agent/following/gains.py",
    "agent/following/slots.py",
)
CORE, COMMANDER, AVAILABLE = "agent/core.py", "agent/safety/commander.py", "agent/following/attachment.py"

DEFECTS = (
    Defect(
        "anti-windup-reversed",
        FIELD,
        "growth = weight * (e + gains.anti_windup * cut_off)",
        "growth = weight * (e - gains.anti_windup * cut_off)",
        "saturation winds the integral up",
        ("quiet",),
    ),
    Defect(
        "integral-never-decays",
        FIELD,
        "integral + dt * growth - (1.0 - weight) * forgotten * integral",
        "integral + dt * growth",
        "the integral stays when the formation is torn",
        ("quiet",),
    ),
    Defect(
        "feed-forward-rotated",
        FIELD,
        "heading.conjugate() * measured.velocity",
        "heading * measured.velocity",
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
        "filter-winds-up",
        CONTROLLER,
        "return integral + dt * weight * gains.anti_windup * cut_off",
        "return integral",
        "what the filter cuts off winds the integral up",
        ("crossing",),
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
        "observer-blind-in-reverse",
        OBSERVER,
        "return kept + share / travel.distance * half * travel.displacement",
        "return kept + share / path * half * travel.displacement",
        "a robot that reverses learns the opposite heading",
        ("quiet", "crossing"),
    ),
    Defect(
        "extrapolated-backwards",
        TRACKER,
        "return track.point + track.velocity * clip(moment - track.stamp, longest)",
        "return track.point - track.velocity * clip(moment - track.stamp, longest)",
        "neighbours are expected where they were",
        ("quiet",),
    ),
    Defect(
        "slots-reversed",
        NEIGHBOURS,
        "desired += slots.state.at[name] - mine",
        "desired += mine - slots.state.at[name]",
        "the formation is mirrored",
        ("quiet",),
    ),
    Defect(
        "slot-velocity-added",
        NEIGHBOURS,
        "velocity += one.velocity - (slots",
        "velocity += one.velocity + (slots",
        "robots lag in shapes that turn",
        ("orders", "bend"),
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
