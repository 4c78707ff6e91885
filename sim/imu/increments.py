"""Increments of an ideal inertial unit: exact integrals of its rates along an analytic motion.

Δθ = ∫ ω_ib^b dt and Δv = ∫ f^b dt over each interval, by Gauss–Legendre quadrature of
ω_ib^b = ω_eb^b + C_be ω_ie and f^b = C_be (a_e + 2 ω_ie × v_e − g_e), T(2.46), T(2.47). Coning
and sculling are in them as in the increments of a real unit: to undo them is the navigator's work.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from deepgnss.core.constants import EARTH_RATE_RADPS
from deepgnss.core.earth import gravity_e_mps2
from deepgnss.core.records import FloatArray, ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.sim.imu.carried import Moving
from deepgnss.sim.motion.vehicle import Pose

_EARTH_RATE_E_RADPS: Final = np.array([0.0, 0.0, EARTH_RATE_RADPS])
_RELATIVE_ERROR: Final = 1e-12
_MOST_NODES: Final = 12
_BLOCK_NODES: Final = 1 << 16  # poses held at a time


def sensed(pose: Pose) -> tuple[FloatArray, FloatArray]:
    """What ideal sensors feel: ω_ib^b in rad/s and specific force f^b in m/s², (n, 3) each."""
    to_b = np.swapaxes(pose.C_eb, -1, -2)
    omega_ib_b = pose.omega_eb_b_radps + to_b @ _EARTH_RATE_E_RADPS
    coriolis = 2.0 * np.cross(_EARTH_RATE_E_RADPS, pose.v_e_mps)
    f_e = pose.a_e_mps2 + coriolis - gravity_e_mps2(pose.r_e_m)
    return omega_ib_b, np.einsum("nij,nj->ni", to_b, f_e)


def panel(interval_s: float, highest_hz: float) -> tuple[int, int]:
    """Panels per interval and nodes per panel that integrate lines up to a frequency.

    The error of n nodes over a panel of half-width h for cos(ωt) is at most
    h·2²ⁿ⁺¹·n!⁴/((2n + 1)·(2n)!³)·(ωh)²ⁿ; ω is twice the highest line, since rates hold products of
    two (coning).
    """
    omega_radps = 2.0 * math.pi * 2.0 * highest_hz
    panels = 1
    while True:
        h_s = 0.5 * interval_s / panels
        for n in range(3, _MOST_NODES + 1):
            log_error = (
                (2 * n + 1) * math.log(2.0)
                + 4.0 * math.lgamma(n + 1)
                - math.log(2 * n + 1)
                - 3.0 * math.lgamma(2 * n + 1)
                + 2 * n * math.log(omega_radps * h_s)
            )
            if log_error < math.log(_RELATIVE_ERROR):
                return panels, n
        panels += 1


def increments(
    body: Moving,
    start: GpsTime,
    rate_hz: float,
    count: int,
    first: int = 0,
    highest_hz: float = 100.0,
) -> Iterator[ImuBlock]:
    """Error-free increments over [k, k + 1)/rate, k = first … first + count − 1, in blocks.

    Parameters
    ----------
    body: the unit itself (`carried.Mounted` for one away from the vehicle's reference point).
    start: GPST of second 0 of the motion; `time_s` of the blocks counts from it.
    highest_hz: highest frequency in the motion that has to be integrated exactly.
    """
    panels, nodes = panel(1.0 / rate_hz, highest_hz)
    per_block = max(_BLOCK_NODES // (panels * nodes), 1)
    for k in range(first, first + count, per_block):
        last = min(k + per_block, first + count)
        edges_s = np.arange(k, last + 1) / rate_hz
        dtheta, dv = _integrals(body, edges_s, panels, nodes)
        yield ImuBlock(start, edges_s[1:], np.diff(edges_s), dtheta, dv)


def _integrals(
    body: Moving, edges_s: FloatArray, panels: int, nodes: int
) -> tuple[FloatArray, FloatArray]:
    """Integrals of both rates between consecutive edges, cut at the motion's breaks."""
    breaks_s = np.asarray(body.breaks_s, dtype=np.float64)
    inside = breaks_s[(breaks_s > edges_s[0]) & (breaks_s < edges_s[-1])]
    parts = np.arange(panels) / panels
    inner = (edges_s[:-1, np.newaxis] + np.diff(edges_s)[:, np.newaxis] * parts).ravel()
    cuts_s = np.union1d(np.append(inner, edges_s[-1]), inside)
    points, weights = np.polynomial.legendre.leggauss(nodes)
    half_s = 0.5 * np.diff(cuts_s)
    middle_s = cuts_s[:-1] + half_s
    pose = body.pose((middle_s[:, np.newaxis] + half_s[:, np.newaxis] * points).ravel())
    starts = np.searchsorted(cuts_s, edges_s[:-1])
    return tuple(  # type: ignore[return-value]
        np.add.reduceat(
            half_s[:, np.newaxis]
            * np.einsum("k,pkj->pj", weights, rate.reshape(half_s.size, nodes, 3)),
            starts,
        )
        for rate in sensed(pose)
    )
