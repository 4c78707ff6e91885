"""Motions over the ellipsoid in closed form, and the increments an ideal unit measures in them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from deepgnss.core import attitude, earth
from deepgnss.core.records import FloatArray, ImuBlock, InsState
from deepgnss.core.time import GpsTime

ORIGIN = GpsTime(2300, 100_000.0)

Derivatives = tuple[FloatArray, FloatArray, FloatArray]
Curve = Callable[[FloatArray], Derivatives]  # value, first and second derivative


def line(start: float, rate: float = 0.0) -> Curve:
    """Start + rate·t."""
    return lambda t: (start + rate * t, np.full_like(t, rate), np.zeros_like(t))


def wave(start: float, rate: float, amplitude: float, frequency_hz: float, phase: float) -> Curve:
    """A line with a sine on it."""
    w = 2.0 * np.pi * frequency_hz

    def curve(t: FloatArray) -> Derivatives:
        sin, cos = np.sin(w * t + phase), np.cos(w * t + phase)
        return (
            start + rate * t + amplitude * sin,
            rate + amplitude * w * cos,
            -amplitude * w * w * sin,
        )

    return curve


class ExactMotion(NamedTuple):
    """Latitude, longitude, height, roll, pitch and yaw over seconds since ORIGIN."""

    lat: Curve
    lon: Curve
    height: Curve
    roll: Curve = line(0.0)
    pitch: Curve = line(0.0)
    yaw: Curve = line(0.0)

    def pose(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Latitude, longitude and height (n, 3), velocity in NED (n, 3), q_nb (n, 4)."""
        place = np.column_stack([curve(t_s)[0] for curve in (self.lat, self.lon, self.height)])
        angles = np.column_stack([curve(t_s)[0] for curve in (self.roll, self.pitch, self.yaw)])
        return place, self._velocity(t_s)[0], attitude.quaternion_from_euler(angles)

    def _velocity(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocity in NED and its derivative, by the chain rule from latitude and longitude."""
        (lat, lat1, lat2), (_, lon1, lon2), (h, h1, h2) = (
            curve(t_s) for curve in (self.lat, self.lon, self.height)
        )
        sin, cos = np.sin(lat), np.cos(lat)
        w2 = 1.0 - earth.ECCENTRICITY2 * sin**2
        transverse = earth.SEMI_MAJOR_M / np.sqrt(w2)
        meridian = earth.SEMI_MAJOR_M * (1.0 - earth.ECCENTRICITY2) / w2**1.5
        transverse1 = transverse * earth.ECCENTRICITY2 * sin * cos / w2 * lat1
        meridian1 = 3.0 * meridian * earth.ECCENTRICITY2 * sin * cos / w2 * lat1
        around, around1 = (
            (transverse + h) * cos,
            (transverse1 + h1) * cos - (transverse + h) * sin * lat1,
        )
        v = np.column_stack([(meridian + h) * lat1, around * lon1, -h1])
        a = np.column_stack(
            [(meridian1 + h1) * lat1 + (meridian + h) * lat2, around1 * lon1 + around * lon2, -h2]
        )
        return v, a

    def sensed(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Angular rate ω_ib_b and specific force f_b (n, 3) at instants."""
        place, v, q_nb = self.pose(t_s)
        v1 = self._velocity(t_s)[1]
        (roll, roll1, _), (pitch, pitch1, _), (_, yaw1, _) = (
            curve(t_s) for curve in (self.roll, self.pitch, self.yaw)
        )
        omega_nb_b = np.column_stack(
            [
                roll1 - yaw1 * np.sin(pitch),
                pitch1 * np.cos(roll) + yaw1 * np.sin(roll) * np.cos(pitch),
                -pitch1 * np.sin(roll) + yaw1 * np.cos(roll) * np.cos(pitch),
            ]
        )
        ie = np.column_stack(earth.earth_rate_n(place[:, 0]))
        en = np.column_stack(earth.transport_rate_n(place[:, 0], place[:, 2], v[:, 0], v[:, 1]))
        gravity = np.zeros_like(v)
        gravity[:, 2] = earth.gravity_mps2(place[:, 0], place[:, 2])
        f_n = v1 + np.cross(2.0 * ie + en, v) - gravity
        q_bn = attitude.quaternion_conjugate(q_nb)
        return omega_nb_b + attitude.rotate(q_bn, ie + en), attitude.rotate(q_bn, f_n)

    def increments(self, edges_s: FloatArray) -> ImuBlock:
        """Integrals between edges (n + 1,), by Gauss–Legendre with eight points."""
        nodes, weights = np.polynomial.legendre.leggauss(8)
        dt_s = np.diff(edges_s)
        instants = edges_s[:-1, np.newaxis] + dt_s[:, np.newaxis] * (nodes + 1.0) / 2.0
        integrals = [
            np.einsum("kjc,j->kc", values.reshape(dt_s.size, nodes.size, 3), weights)
            * dt_s[:, np.newaxis]
            / 2.0
            for values in self.sensed(instants.ravel())
        ]
        return ImuBlock(ORIGIN, edges_s[1:], dt_s, *integrals)

    def state(self, t_s: float = 0.0) -> InsState:
        """True navigation state at an instant, sensors without error."""
        place, v, q = (part[0] for part in self.pose(np.array([t_s])))
        return InsState(
            ORIGIN.plus(t_s),
            *(float(x) for x in place),
            v,
            q,
            *(np.zeros(3) for _ in range(4)),
        )


def drive(lat: float = 0.55, lon: float = 1.99) -> ExactMotion:
    """A lively drive: 15 m/s with turns, climbs, pitching and rolling, some m/s² and rad/s."""
    r_m = earth.SEMI_MAJOR_M
    return ExactMotion(
        wave(lat, 12.0 / r_m, 25.0 / r_m, 0.05, 0.3),
        wave(lon, 9.0 / r_m, 30.0 / r_m, 0.04, 1.1),
        wave(60.0, 0.5, 2.0, 0.1, 0.0),
        wave(0.02, 0.0, 0.10, 0.31, 0.5),
        wave(-0.03, 0.0, 0.08, 0.23, 0.9),
        wave(0.7, 0.1, 0.8, 0.07, 0.2),
    )
