"""The laws of the yardstick that are not ours: a follower, and a predictive law.

The **follower** does what follower examples of small robots do (turtlebot3_follower is one): it turns towards
the robot before it and keeps a distance, at a speed in proportion. It knows no shape. Written anew from the
idea.

The **predictive** law solves a quadratic program in each step. It minimises, over `STEPS` intervals, the
distance of the control point from where its neighbours want it, the neighbours predicted at constant
velocity, and the change of the inputs. The squared distances to several neighbours' points differ from that
to their mean by a constant, so the sums of `Measured` are all it needs. The unicycle is linearised along the
motion of a saturated proportional law, once in each step. Inputs stay within u_max and ω_max.

| gain of [law] | follower | predictive law |
|---|---|---|
| `k_p` | speed for each metre too far [1/s] | intervals in a second [1/s] |
| `k_i` | turn rate for each radian of bearing [1/s] | weight of the change of inputs [s²] |
"""

from __future__ import annotations

import math
from typing import Any

import daqp
import numpy as np
from numba import objmode

from formation.control.controller import Controller, Gains, Limits, Measured
from formation.control.observer import INNOVATION
from formation.control.plane import clip, rotation
from formation.control.unicycle import Command, saturate

STEPS = 10
"""Intervals of the horizon."""
LAST_WEIGHT = 5.0
"""Weight of the last distance, that of each other being 1."""
NOMINAL_GAIN = 4.0
"""Gain of the motion along which the unicycle is linearised [1/s], at most half an interval's inverse."""
TRUST_WEIGHT = 1e-4
"""Weight of the inputs' distance from that motion [s²]: it keeps the program convex and the model near."""


def following(
    integral: complex, _heading: complex, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, complex]:
    """Turn towards the one neighbour, and close what is missing of the distance to keep."""
    bearing = math.atan2(measured.relative.imag, measured.relative.real)
    missing = abs(measured.relative) - abs(measured.desired)
    speed = clip(gains.k_p * missing, limits.max_speed)
    return Command(speed, clip(gains.k_i * bearing, limits.max_turn_rate)), integral


def predictive(
    integral: complex, heading: complex, measured: Measured, gains: Gains, limits: Limits, _dt: float
) -> tuple[Command, complex]:
    """The first inputs of the best motion over the horizon."""
    to_body = heading.conjugate()
    away = (measured.relative - to_body * measured.desired) / measured.count
    carried = to_body * measured.velocity
    hessian, slope, low, high, nominal = program(away, carried, 1.0 / gains.k_p, gains.k_i, limits)
    with objmode(change="float64[:]"):
        change = daqp.solve(hessian, slope, np.zeros((0, len(slope))), high, low)[0]
    speed = clip(nominal[0] + change[0], limits.max_speed)
    return Command(speed, clip(nominal[1] + change[1], limits.max_turn_rate)), integral


def program(away: complex, carried: complex, interval: float, weight: float, limits: Limits) -> Any:
    """The quadratic program in the changes of u, ω of each interval [m/s, rad/s] to the nominal motion.

    `away` is from the control point to where the neighbours want it [m], `carried` their velocity [m/s], both
    in the body frame of now. Returns its matrix, vector, bounds, and the nominal u, ω; shapes (2 STEPS, …).
    """
    hessian, slope = np.zeros((2 * STEPS, 2 * STEPS)), np.zeros(2 * STEPS)
    nominal, effect = np.zeros(2 * STEPS), np.zeros(2 * STEPS, dtype=np.complex128)
    gain = min(NOMINAL_GAIN, 0.5 / interval)
    point, angle = 0j, 0.0
    for k in range(STEPS):
        facing, target = rotation(angle), away + k * interval * carried
        wanted = facing.conjugate() * (carried + gain * (target - point))
        inputs = saturate(wanted, limits.offset, limits.max_speed, limits.max_turn_rate)
        nominal[2 * k], nominal[2 * k + 1] = inputs
        moving = facing * complex(inputs.speed, limits.offset * inputs.turn_rate)
        for j in range(k):
            effect[2 * j + 1] += 1j * interval * interval * moving  # a turn before turns the velocity now
        effect[2 * k] = interval * facing
        effect[2 * k + 1] = 1j * limits.offset * interval * facing
        point, angle = point + interval * moving, angle + interval * inputs.turn_rate
        missed = point - (target + interval * carried)
        share = LAST_WEIGHT if k == STEPS - 1 else 1.0
        for i in range(2 * k + 2):
            slope[i] += share * (effect[i].conjugate() * missed).real
            for j in range(2 * k + 2):
                hessian[i, j] += share * (effect[i].conjugate() * effect[j]).real
    smoothed(hessian, slope, nominal, weight, limits.offset)
    most = np.empty(2 * STEPS)
    most[0::2], most[1::2] = limits.max_speed, limits.max_turn_rate
    return hessian, slope, -most - nominal, most - nominal, nominal


def smoothed(hessian: Any, slope: Any, nominal: Any, weight: float, offset: float) -> None:
    """Add the cost of inputs that change from one interval to the next, and that leave the nominal ones."""
    for i in range(2 * STEPS):
        length = 1.0 if i % 2 == 0 else offset
        hessian[i, i] += TRUST_WEIGHT * length * length
        if i < 2:
            continue
        cost = weight * length * length
        hessian[i, i] += cost
        hessian[i - 2, i - 2] += cost
        hessian[i, i - 2] -= cost
        hessian[i - 2, i] -= cost
        slope[i] += cost * (nominal[i] - nominal[i - 2])
        slope[i - 2] -= cost * (nominal[i] - nominal[i - 2])


FOLLOWER = Controller(
    "follower", following, INNOVATION, feed_forward=False, delay_compensation=False, ramp=False
)
PREDICTIVE = Controller("predictive", predictive, INNOVATION, ramp=False)
