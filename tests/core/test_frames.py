"""Earth frames against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.frames import C_ne, azimuth_elevation, ecef, geodetic

# A point of the WGS-84 ellipsoid worked out by hand: a = 6378137 m, b = 6356752.3142 m.
EQUATOR, POLE_HEIGHT_M = 6_378_137.0, 6_356_752.314_245

latitudes = st.floats(-1.55, 1.55)
longitudes = st.floats(-3.1, 3.1)
quick = settings(deadline=None, derandomize=True, max_examples=50)


def test_axes_of_the_ellipsoid() -> None:
    np.testing.assert_allclose(ecef(0.0, 0.0, 10.0), [EQUATOR + 10.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(ecef(0.0, np.pi / 2, 0.0), [0.0, EQUATOR, 0.0], atol=1e-6)
    np.testing.assert_allclose(
        ecef(np.pi / 2, 0.0, 5.0), [0.0, 0.0, POLE_HEIGHT_M + 5.0], atol=1e-6
    )


@given(lat=latitudes, lon=longitudes, height=st.floats(-500.0, 20_000.0))
@quick
def test_geodetic_and_back(lat: float, lon: float, height: float) -> None:
    back = geodetic(ecef(lat, lon, height))
    assert back[0] == pytest.approx(lat, abs=1e-12)
    assert back[1] == pytest.approx(lon, abs=1e-12)
    assert back[2] == pytest.approx(height, abs=1e-6)


@given(lat=latitudes, lon=longitudes)
@quick
def test_rows_of_the_rotation_are_north_east_down(lat: float, lon: float) -> None:
    """Derivatives of the position itself, by small steps of latitude, longitude and height."""
    C, h = C_ne(lat, lon), 1e-6
    np.testing.assert_allclose(C @ C.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(C) == pytest.approx(1.0)
    north = ecef(lat + h, lon, 0.0) - ecef(lat - h, lon, 0.0)
    east = ecef(lat, lon + h, 0.0) - ecef(lat, lon - h, 0.0)
    down = ecef(lat, lon, -1.0) - ecef(lat, lon, 1.0)
    for row, step in zip(C, (north, east, down), strict=True):
        np.testing.assert_allclose(row, step / np.linalg.norm(step), atol=1e-6)


@given(
    lat=latitudes,
    lon=longitudes,
    azimuth=st.floats(0.0, 6.28),
    elevation=st.floats(-0.5, 1.5),
)
@quick
def test_azimuth_clockwise_from_north_and_elevation_up(
    lat: float, lon: float, azimuth: float, elevation: float
) -> None:
    r_e_m = ecef(lat, lon, 100.0)
    los_n = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            -np.sin(elevation),
        ]
    )
    point = r_e_m + 2.2e7 * C_ne(lat, lon).T @ los_n
    found = azimuth_elevation(r_e_m, np.stack([point, point]))
    assert found[0].shape == found[1].shape == (2,)
    assert np.all((found[0] >= 0.0) & (found[0] < 2.0 * np.pi))
    # heights of 100 m come back to some 1e-8 m only near the poles
    np.testing.assert_allclose(np.cos(found[0] - azimuth), 1.0, atol=1e-12)
    np.testing.assert_allclose(found[1], elevation, atol=1e-7)
