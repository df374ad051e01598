r"""Kalman filter of a robot's own pose: a position that noise hardly reaches, and the heading it shows.

Not in the paper. The state is the centre p and the heading ζ, both complex. Since odometry measures the path
Δs and the turn Δθ, the prediction is linear in it, and ζ needs no length one:

    p ← p + a ζ,  ζ ← b ζ,   a = Δs sinc(Δθ/2) e^{iΔθ/2},  b = e^{iΔθ}

Each measured position corrects both. A robot publishes p̂ + L ζ̂/|ζ̂|, so filters at the receivers are not
needed and no delay is added. The variance R of measured positions adapts to the scatter of the innovations,
|ν - ν_before|²/2: noise scatters, and a robot that is carried, or a corrected map, does not. It never falls
below what the mission expects.

| symbol | here | meaning | unit |
|---|---|---|---|
| p̂, ζ̂ | `position`, `heading` | estimates, world frame; ζ̂ has any length | m, – |
| P | `Spread` | covariance of their errors, complex: E \|x\|² | |
| ν, S | `innovation`, `variance` | measured less predicted position, and its variance | m, m² |
| R | `Spread.noise` | variance of a measured position, both axes together | m² |
"""

from __future__ import annotations

from typing import NamedTuple

from formation.control.observer import Travel
from formation.control.plane import rotation

UNKNOWN_HEADING_VARIANCE = 2.0
"""Variance of a heading that is only guessed [–]."""
NOISE_RATIO = 2.5
"""Standard deviation of positions that the filter assumes at least, as a multiple of the expected one: what
smoothing costs shows only where the measured motion is wrong."""
MIN_NOISE = 0.002
"""Least standard deviation of positions that is expected, per axis [m]."""
OUTLIER_RATIO = 100.0
"""An innovation is no noise if its square is above this multiple of its variance (ten standard deviations):
the robot was moved, or its positions were corrected."""
CHANGE_SHARE = 1.0
"""Error of a path, as a share of the change of speed in it: twice the bound of one interval, because the
errors of an acceleration add up [–]."""


class Spread(NamedTuple):
    """Covariance of the pose's error, and the noise of positions."""

    position: float
    """E |p̂ - p|² [m²]."""
    cross: complex
    """E (p̂ - p) conj(ζ̂ - ζ) [m]."""
    heading: float
    """E |ζ̂ - ζ|² [–]."""
    noise: float
    """R [m²]."""
    innovation: complex
    """The newest ν [m]."""


class MotionNoise(NamedTuple):
    """Errors of the measured motion, by which the covariance grows."""

    position: float
    """Of the position, with the root of the path [m/√m]."""
    heading: float
    """Of the heading, with the root of the path [rad/√m]."""
    turn: float
    """Of the heading, with the root of the turn [rad/√rad]."""
    rest: float
    """Of the position, with the root of the time [m/√s]: slow corrections of a localisation."""


ODOMETRY_NOISE = MotionNoise(1e-3, 0.02, 0.0, 3e-4)
"""Motion as wheels and gyroscope measure it."""
COMMANDED_NOISE = MotionNoise(0.02, 0.05, 0.1, 1e-3)
"""Motion of a robot of which only the commands are known: wheels lag and slip."""


def path_error(speed_before: float, speed: float, dt: float) -> float:
    """Error of a path [m] that is the mean of two speeds [m/s] times `dt` [s].

    The speed may have changed at any moment between the two.
    """
    return CHANGE_SHARE * abs(speed - speed_before) * dt


def least_noise(noise: float) -> float:
    """Least R [m²] where positions have the standard deviation `noise` per axis [m]."""
    assumed = NOISE_RATIO * max(noise, MIN_NOISE)
    return 2.0 * assumed * assumed


def first_spread(least: float) -> Spread:
    """Covariance after the first position, with a guessed heading; `least` is the least R [m²]."""
    return Spread(least, 0j, UNKNOWN_HEADING_VARIANCE, least, 0j)


def replaced(spread: Spread) -> Spread:
    """Covariance after a position that the motion does not explain; the heading is as certain as before."""
    return Spread(spread.noise, 0j, spread.heading, spread.noise, 0j)


def restarted(spread: Spread) -> bool:
    """Whether the newest position was taken as it is: the motion does not explain it."""
    return spread.position == spread.noise and spread.cross == 0j


def filtered(
    position: complex, heading: complex, spread: Spread, travel: Travel, measured: complex, dt: float,
    least: float, motion: MotionNoise, unsure: float = 0.0,
) -> tuple[complex, complex, Spread]:  # fmt: skip
    """Pose and covariance after an interval of `dt` [s] with `travel`, `measured` at its end.

    `measured` is a position [m; world frame], `least` the least R [m²], `unsure` the error of the path [m]
    where its speed has changed on the way.
    """
    path, lean = abs(travel.distance), 0.5 * travel.turn
    half = rotation(lean)
    turn = half * half
    a = (travel.distance * half.imag / lean if lean != 0.0 else travel.distance) * half
    position, heading = position + a * heading, turn * heading
    length = a.real * a.real + a.imag * a.imag
    cross = spread.cross + spread.heading * a
    along = a.real * spread.cross.real + a.imag * spread.cross.imag  # Re(conj(a) P12)
    grown = motion.position * motion.position * path + motion.rest * motion.rest * dt + unsure * unsure
    p11 = spread.position + 2.0 * along + length * spread.heading + grown
    p12 = turn.conjugate() * cross
    p22 = (
        spread.heading + motion.heading * motion.heading * path + motion.turn * motion.turn * abs(travel.turn)
    )
    innovation, variance = measured - position, p11 + spread.noise
    inverse = 1.0 / variance
    squared = innovation.real * innovation.real + innovation.imag * innovation.imag
    if squared > OUTLIER_RATIO * variance:
        return measured, heading, Spread(spread.noise, 0j, p22, spread.noise, 0j)
    position += p11 * inverse * innovation
    heading += p12.conjugate() * (inverse * innovation)
    trust = spread.noise * inverse
    change = innovation - spread.innovation
    scatter = 0.5 * (change.real * change.real + change.imag * change.imag)
    noise = max(least, spread.noise + dt * trust * trust * (scatter - variance))
    size = p12.real * p12.real + p12.imag * p12.imag
    after = Spread(trust * p11, trust * p12, max(0.0, p22 - size * inverse), noise, innovation)
    return position, heading, after
