"""Delays of ionosphere and troposphere: sign, size, scaling, and behaviour at the edges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_sky import KLOBUCHAR

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.core.records import BDS_B1I, GPS_L1CA, Klobuchar
from deepgnss.receiver.atmosphere import (
    klobuchar_delay,
    saastamoinen_delay,
    standard_atmosphere,
)

quiet = settings(deadline=None, derandomize=True, max_examples=100)
NIGHT = Klobuchar((0.0,) * 4, (0.0,) * 4)


def klobuchar_twin(
    c: Klobuchar, lat: float, lon: float, az: float, el: float, tow_s: float
) -> float:
    """IS-GPS-200 20.3.3.5.2.5 in the order of the text, seconds at L1."""
    E, phi_u, lam_u = el / np.pi, lat / np.pi, lon / np.pi
    psi = 0.0137 / (E + 0.11) - 0.022
    phi_i = min(max(phi_u + psi * np.cos(az), -0.416), 0.416)
    lam_i = lam_u + psi * np.sin(az) / np.cos(phi_i * np.pi)
    phi_m = phi_i + 0.064 * np.cos((lam_i - 1.617) * np.pi)
    t = (4.32e4 * lam_i + tow_s) % 86_400
    F = 1.0 + 16.0 * (0.53 - E) ** 3
    period = max(sum(b * phi_m**n for n, b in enumerate(c.beta)), 72_000.0)
    amplitude = max(sum(a * phi_m**n for n, a in enumerate(c.alpha)), 0.0)
    x = 2 * np.pi * (t - 50_400) / period
    if abs(x) >= 1.57:
        return F * 5e-9
    return F * (5e-9 + amplitude * (1 - x**2 / 2 + x**4 / 24))


@quiet
@given(
    st.floats(-1.5, 1.5),
    st.floats(-3.1, 3.1),
    st.floats(0.0, 6.28),
    st.floats(0.0, 1.57),
    st.floats(0.0, 604_799.0),
)
def test_klobuchar_against_the_text(
    lat: float, lon: float, az: float, el: float, tow_s: float
) -> None:
    got = klobuchar_delay(KLOBUCHAR, lat, lon, np.array([az]), np.array([el]), tow_s)
    assert got[0] == pytest.approx(C * klobuchar_twin(KLOBUCHAR, lat, lon, az, el, tow_s))


def test_ionosphere_by_night_by_day_and_at_other_frequencies() -> None:
    az, el = np.zeros(3), np.radians([90.0, 30.0, 5.0])
    night_m = klobuchar_delay(NIGHT, 0.5, 0.0, az, el, 0.0)
    assert night_m[0] == pytest.approx(1.5, abs=0.01)  # 5 ns
    assert (np.diff(night_m) > 0).all()
    noon_m = klobuchar_delay(KLOBUCHAR, 0.5, 0.0, az, el, 50_400.0)
    assert (noon_m > klobuchar_delay(KLOBUCHAR, 0.5, 0.0, az, el, 0.0) + 1.0).all()
    b1i_m = klobuchar_delay(KLOBUCHAR, 0.5, 0.0, az, el, 50_400.0, BDS_B1I.carrier_hz)
    assert b1i_m / noon_m == pytest.approx((GPS_L1CA.carrier_hz / BDS_B1I.carrier_hz) ** 2)
    assert (b1i_m > noon_m).all()


@quiet
@given(st.floats(-1.57, 1.57), st.floats(-3.14, 3.14), st.floats(-1.57, 0.0), st.floats(-2e3, 8e4))
def test_delays_below_the_horizon_and_high_up_are_sensible(
    lat: float, lon: float, el: float, height_m: float
) -> None:
    below, horizon = np.array([el]), np.zeros(1)
    assert klobuchar_delay(KLOBUCHAR, lat, lon, horizon, below, 0.0) == pytest.approx(
        klobuchar_delay(KLOBUCHAR, lat, lon, horizon, horizon, 0.0)
    )
    assert 0.0 <= saastamoinen_delay(lat, height_m, below)[0] < 80.0


def test_standard_atmosphere_against_icao_tables() -> None:
    for height_m, pressure_hpa, temperature_k in (
        (0.0, 1013.25, 288.15),
        (5000.0, 540.2, 255.65),
        (11_000.0, 226.32, 216.65),
        (20_000.0, 54.75, 216.65),
    ):
        got = standard_atmosphere(height_m)
        assert got[0] == pytest.approx(pressure_hpa, rel=1e-3)
        assert got[2] == pytest.approx(temperature_k, abs=0.01)


def test_troposphere_zenith_mapping_and_height() -> None:
    zenith = np.array([np.pi / 2])
    dry_m = saastamoinen_delay(np.pi / 4, 0.0, zenith, 0.0)[0]
    assert dry_m == pytest.approx(2.3070, abs=1e-3)  # 2.2768 mm/hPa × 1013.25 hPa
    wet_m = saastamoinen_delay(np.pi / 4, 0.0, zenith, 1.0)[0] - dry_m
    assert 0.1 < wet_m < 0.25
    elevation = np.radians([90.0, 60.0, 30.0, 15.0, 10.0, 5.0, 3.0, 2.0])
    delay_m = saastamoinen_delay(0.5, 0.0, elevation)
    assert (np.diff(delay_m) > 0.0).all()
    mapping = delay_m / delay_m[0]
    assert mapping[2] == pytest.approx(2.0, rel=0.005)
    assert mapping[4] == pytest.approx(5.60, rel=0.01)  # Niell hydrostatic: 5.56 … 5.61
    assert mapping[5] == pytest.approx(10.15, rel=0.02)
    heights_m = [-500.0, 0.0, 3000.0, 10_999.0, 11_001.0, 30_000.0]
    by_height_m = [float(saastamoinen_delay(0.5, h, zenith)[0]) for h in heights_m]
    assert (np.diff(by_height_m) < 0.0).all()
    assert by_height_m[3] == pytest.approx(by_height_m[4], rel=1e-3)
    assert by_height_m[-1] < 0.05
