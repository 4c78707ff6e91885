"""The ellipsoid: published gravity, radii against geometry, rates of the frame by differences."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core import earth
from deepgnss.core.constants import EARTH_RATE_RADPS, GM_GPS_M3PS2
from deepgnss.core.frames import C_ne, ecef

pytestmark = pytest.mark.kernel

LAT, LON, HEIGHT = 0.53, 1.99, 800.0


def test_published_normal_gravity() -> None:
    """NIMA TR8350.2 table 3.4: pole 9.8321849378; mean over 45° of GRS 80 tables, 9.80620."""
    assert earth.gravity_mps2(0.0, 0.0) == pytest.approx(9.7803253359, abs=1e-12)
    assert earth.gravity_mps2(np.pi / 2, 0.0) == pytest.approx(9.8321849378, abs=1e-9)
    assert earth.gravity_mps2(np.pi / 4, 0.0) == pytest.approx(9.80620, abs=2e-5)


def test_gravity_falls_with_height_as_attraction_less_centrifugal() -> None:
    """On the equator: GM/r² − ω²r to the oblateness, whose share of the slope is below 1 %."""

    def sphere(height_m: float) -> float:
        r_m = earth.SEMI_MAJOR_M + height_m
        return GM_GPS_M3PS2 / r_m**2 - EARTH_RATE_RADPS**2 * r_m

    drop = earth.gravity_mps2(0.0, 0.0) - earth.gravity_mps2(0.0, 10_000.0)
    assert drop == pytest.approx(sphere(0.0) - sphere(10_000.0), rel=0.01)


def test_radii_are_the_way_on_the_ground() -> None:
    """A small step in latitude or longitude moves by the radius times the angle."""
    step = 1e-6
    north = (ecef(LAT + step, LON, HEIGHT) - ecef(LAT - step, LON, HEIGHT)) / (2.0 * step)
    east = (ecef(LAT, LON + step, HEIGHT) - ecef(LAT, LON - step, HEIGHT)) / (2.0 * step)
    assert np.linalg.norm(north) == pytest.approx(earth.meridian_radius_m(LAT) + HEIGHT, rel=1e-8)
    around = (earth.transverse_radius_m(LAT) + HEIGHT) * np.cos(LAT)
    assert np.linalg.norm(east) == pytest.approx(around, rel=1e-8)


def test_earth_rate_is_the_axis_in_the_local_frame() -> None:
    axis_n = C_ne(LAT, LON) @ np.array([0.0, 0.0, EARTH_RATE_RADPS])
    np.testing.assert_allclose(earth.earth_rate_n(LAT), axis_n, atol=1e-20)


def test_transport_rate_is_the_turning_of_the_local_frame() -> None:
    """[ω_en_n ×] = C_ne d(C_en)/dt while moving north and east."""
    north_mps, east_mps, dt = 300.0, -200.0, 0.5
    lat_rate = north_mps / (earth.meridian_radius_m(LAT) + HEIGHT)
    lon_rate = east_mps / ((earth.transverse_radius_m(LAT) + HEIGHT) * np.cos(LAT))
    before, after = (C_ne(LAT + s * lat_rate * dt, LON + s * lon_rate * dt) for s in (-1.0, 1.0))
    turning = C_ne(LAT, LON) @ (after - before).T / (2.0 * dt)
    rate = earth.transport_rate_n(LAT, HEIGHT, north_mps, east_mps)
    expected = [turning[2, 1], turning[0, 2], turning[1, 0]]
    np.testing.assert_allclose(rate, expected, rtol=1e-7)


def test_gravity_in_ecef_points_down_the_normal() -> None:
    points = np.array([ecef(LAT, LON, HEIGHT), ecef(-0.9, -2.0, 0.0)])
    gravity = earth.gravity_e_mps2(points)
    np.testing.assert_allclose(
        C_ne(LAT, LON) @ gravity[0], [0.0, 0.0, earth.gravity_mps2(LAT, HEIGHT)], atol=1e-8
    )
    np.testing.assert_allclose(earth.gravity_e_mps2(points[1]), gravity[1], rtol=1e-15)


def test_arrays_give_what_numbers_give() -> None:
    lat, height = np.array([0.1, -0.5, 1.2]), np.array([0.0, 1e3, 9e3])
    north, east = np.array([10.0, -20.0, 30.0]), np.array([-5.0, 6.0, 7.0])
    for k in range(3):
        assert earth.gravity_mps2(lat, height)[k] == earth.gravity_mps2(lat[k], height[k])
        np.testing.assert_allclose(
            np.array(earth.transport_rate_n(lat, height, north, east))[:, k],
            earth.transport_rate_n(lat[k], height[k], north[k], east[k]),
            rtol=1e-15,
        )
