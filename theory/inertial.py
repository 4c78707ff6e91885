"""How velocity and position of an unaided inertial navigation spread, T 4.3, T(4.30–4.32), T 4.5.

Over times far below the Schuler period (84 min) the errors of velocity obey δv̇ = f×φ + δf and
φ̇ = −δω with a constant specific force f in NED, T(4.13). What is drawn once (initial errors, bias,
scale) gives powers of time, T(4.77–4.83), T(4.102–4.108); white noise through an impulse response
h(t) gives the variance density²·∫h² dt, T(4.62), T(4.84–4.99), T(4.109–4.123). T lets the drift
be a random walk there; here it keeps its correlation time.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from deepgnss.core.records import FloatArray, ImuGrade
from deepgnss.theory.loop_response import OPEN, Loop, Response, drawn_response, white_response

_AXES_N: Final = np.eye(3)
_NED: Final = ("north", "east", "down")


class Source(NamedTuple):
    """One error of one axis, and how it reaches the velocity along m directions."""

    name: str
    axis: str  # of the error, in NED
    white: bool  # noise on the way, not drawn once
    gain: FloatArray  # (m,) its 1σ or density, signed, m/s over s^order (white: per √Hz more)
    order: int  # integrations that lead to the velocity
    correlation_s: float = math.inf  # of what a white noise drives

    def response(self, time_s: FloatArray, loop: Loop = OPEN) -> Response:
        """What a loop makes of it over time, per unit of gain."""
        return _response(self.white, self.order, self.correlation_s, loop, time_s.tobytes())


@lru_cache(maxsize=256)
def _response(white: bool, order: int, correlation_s: float, loop: Loop, times: bytes) -> Response:
    """Units share it, and so do all forces: times are those of `Source.response`."""
    time_s = np.frombuffer(times, dtype=np.float64)
    if white:
        return white_response(loop, order, time_s, correlation_s)
    return drawn_response(loop, order, time_s)


def sources(
    grade: ImuGrade, f_n_mps2: FloatArray, along_n: FloatArray = _AXES_N
) -> tuple[Source, ...]:
    """All errors of a unit at a constant specific force (3,) in NED, T(4.30–4.32), axis by axis.

    Initial errors are the grade's; the vertical velocity's is that of the horizontal ones. A
    vehicle at rest has f = (0, 0, −g). along_n: unit vectors (m, 3) along which velocity is told.
    Signs are those of velocity error = estimate − truth for errors of +1σ.
    """
    f = np.asarray(f_n_mps2, dtype=np.float64)
    u = np.asarray(along_n, dtype=np.float64)
    turned = np.cross(u, f)  # u·(f×φ) = φ·(u×f)
    tilts = np.array([grade.tilt_rad, grade.tilt_rad, grade.heading_rad])
    gyro_s, accel_s = grade.gyro_drift_time_s, grade.accel_drift_time_s
    kinds: tuple[tuple[str, bool, FloatArray, int, float], ...] = (
        ("initial velocity", False, u * grade.velocity_mps, 0, math.inf),
        ("initial attitude", False, turned * tilts, 1, math.inf),
        ("accelerometer bias", False, u * grade.accel_bias_mps2, 1, math.inf),
        ("accelerometer scale", False, u * f * grade.accel_scale, 1, math.inf),
        ("gyro bias", False, -turned * grade.gyro_bias_radps, 2, math.inf),
        ("accelerometer noise", True, u * grade.accel_noise_mps_rts, 0, math.inf),
        ("accelerometer drift", True, u * grade.accel_drift_mps3_rthz, 1, accel_s),
        ("gyro noise", True, -turned * grade.gyro_noise_rad_rts, 1, math.inf),
        ("gyro drift", True, -turned * grade.gyro_drift_radps2_rthz, 2, gyro_s),
    )
    return tuple(
        Source(name, axis, white, gains[:, k], order, correlation_s)
        for name, white, gains, order, correlation_s in kinds
        for k, axis in enumerate(_NED)
    )


class Term(NamedTuple):
    """1σ along m directions (NED unless others were asked for) over time from one source."""

    name: str
    white: bool  # driven by noise on the way, not drawn once
    velocity_mps: FloatArray  # (n, m)
    position_m: FloatArray  # (n, m)


def error_growth(
    grade: ImuGrade,
    f_n_mps2: FloatArray,
    time_s: FloatArray,
    along_n: FloatArray = _AXES_N,
    loop: Loop = OPEN,
) -> tuple[Term, ...]:
    """Each source's share of the errors after times (n,), rising, at constant specific force (3,).

    A source's three axes are taken together; a position error at the start is left to the caller.
    A tilt moves several axes at once, so that what it does along a line of sight does not follow
    from NED alone: ask for the line itself (`along_n`). With a loop, position is what the loop
    leaves of it: its phase error in metres.
    """
    t = np.asarray(time_s, dtype=np.float64)
    terms = []
    every = sources(grade, f_n_mps2, along_n)
    for north, *others in zip(*(every[k :: len(_NED)] for k in range(len(_NED))), strict=True):
        response = north.response(t, loop)
        gain = np.sqrt(np.sum([source.gain**2 for source in (north, *others)], axis=0))
        terms.append(
            Term(
                north.name,
                north.white,
                np.outer(response.frequency, gain),
                np.outer(response.phase, gain),
            )
        )
    return tuple(terms)


def total(terms: tuple[Term, ...]) -> tuple[FloatArray, FloatArray]:
    """1σ of velocity and position (n, m) each from independent terms together."""
    velocity2 = np.sum([term.velocity_mps**2 for term in terms], axis=0)
    position2 = np.sum([term.position_m**2 for term in terms], axis=0)
    return np.sqrt(velocity2), np.sqrt(position2)


class Sums(NamedTuple):
    """Errors along one direction over time, (n,), m or m/s, as they may be added up."""

    signed: FloatArray  # what is drawn once, every error at +1σ: T's total of the determined terms
    largest: FloatArray  # the same with the signs that hurt most
    drawn: FloatArray  # its 1σ
    white: FloatArray  # 1σ of the noise on the way: T's total of the others

    @property
    def sigma(self) -> FloatArray:
        """1σ of all of it."""
        return np.hypot(self.drawn, self.white)


def error_sums(
    grade: ImuGrade,
    f_n_mps2: FloatArray,
    time_s: FloatArray,
    along_n: FloatArray,
    loop: Loop = OPEN,
) -> tuple[Sums, Sums]:
    """Velocity and position along one direction (3,), summed in the ways T 4.4.4 and 4.5.3 do.

    T adds what is drawn once with signs, every error at its +1σ, and what is noise by squares.
    """
    t = np.asarray(time_s, dtype=np.float64)
    every = sources(grade, f_n_mps2, np.asarray(along_n, dtype=np.float64)[np.newaxis])
    of_name = {source.name: source.response(t, loop) for source in every[:: len(_NED)]}
    responses = [of_name[source.name] for source in every]

    def summed(which: str) -> Sums:
        drawn, white = (
            np.array(
                [
                    source.gain[0] * getattr(response, which)
                    for source, response in zip(every, responses, strict=True)
                    if source.white is noise
                ]
            )
            for noise in (False, True)
        )
        return Sums(
            drawn.sum(axis=0),
            np.abs(drawn).sum(axis=0),
            np.sqrt(np.sum(drawn**2, axis=0)),
            np.sqrt(np.sum(white**2, axis=0)),
        )

    return summed("frequency"), summed("phase")
