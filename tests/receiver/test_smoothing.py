"""Carrier-smoothed ranges: what they follow, average, forget, and when they start anew."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray, Observation
from deepgnss.core.time import GpsTime
from deepgnss.receiver.smoothing import HatchState, smooth

_WAVELENGTH_M = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
_START = GpsTime(2290, 604_790.0)  # runs over the week's end


def _seen(range_m: float, carrier_m: float, *, arc: int = 1, phase: bool = False) -> Observation:
    return Observation(
        satellite="G05",
        signal=GPS_L1CA.name,
        pseudorange_m=range_m,
        carrier_cycles=carrier_m / _WAVELENGTH_M,
        doppler_hz=0.0,
        cn0_dbhz=21.5,
        lock_time_s=0.0,
        slip=False,
        half_cycle=False,
        carrier_valid=phase,
        transmit=_START,
        arc=arc,
    )


def _smoothed(
    codes_m: FloatArray, carriers_m: FloatArray, *, aided: bool, phase: bool = False
) -> FloatArray:
    """Smoothed ranges of an observation a second."""
    state, out = HatchState(), []
    for k, (code_m, carrier_m) in enumerate(zip(codes_m, carriers_m, strict=True)):
        seen = _seen(code_m, carrier_m, phase=phase)
        state, better = smooth(state, seen, _START.plus(float(k)), aided=aided)
        out.append(better.pseudorange_m)
    return np.array(out)


def test_a_moving_range_is_followed_by_its_carrier() -> None:
    """Code and carrier grow together with the range; a constant between them stays out."""
    t_s = np.arange(200.0)
    range_m = 2.2e7 + 600.0 * t_s - 0.4 * t_s**2
    assert _smoothed(range_m, range_m - 1234.5, aided=True) == pytest.approx(range_m, abs=1e-6)


def test_noise_falls_as_in_a_running_mean_and_then_stays() -> None:
    """The mean of n; then that of a filter which forgets over τ: variance 1/2τ of white noise."""
    random = np.random.default_rng(5)
    spread = np.array(
        [_smoothed(random.standard_normal(401), np.zeros(401), aided=True) for _ in range(300)]
    ).std(axis=0)
    assert spread[24] == pytest.approx(1.0 / 5.0, rel=0.12)
    assert spread[400] == pytest.approx(math.sqrt(1.0 / 200.0), rel=0.12)


@pytest.mark.parametrize(
    ("aided", "phase", "tau_s"), [(True, False, 100.0), (False, False, 20.0), (False, True, 100.0)]
)
def test_a_step_of_the_carrier_is_forgotten(*, aided: bool, phase: bool, tau_s: float) -> None:
    """What runs away unnoticed leaves as e^(−t/τ): soon where nothing tells how one moves."""
    carrier_m = np.where(np.arange(400) < 200, 0.0, 7.0)
    off_m = _smoothed(np.zeros(400), carrier_m, aided=aided, phase=phase)
    assert off_m[199] == pytest.approx(0.0, abs=1e-9)
    assert off_m[200] == pytest.approx(7.0, rel=0.1)
    later = 200 + int(tau_s)
    assert off_m[later] / 7.0 == pytest.approx(math.exp(-1.0), abs=0.03)


@pytest.mark.parametrize(("arc", "phase"), [(2, False), (1, True)])
def test_it_starts_anew_with_a_slip_and_with_a_change_of_lock(arc: int, *, phase: bool) -> None:
    state = HatchState()
    for k in range(50):
        state, _ = smooth(state, _seen(100.0, 3.0), _START.plus(float(k)), aided=True)
    fresh = _seen(105.0, -40.0, arc=arc, phase=phase)
    state, better = smooth(state, fresh, _START.plus(50.0), aided=True)
    assert better.pseudorange_m == 105.0
    _, after = smooth(
        state, _seen(107.0, -40.0, arc=arc, phase=phase), _START.plus(51.0), aided=True
    )
    assert after.pseudorange_m == pytest.approx(106.0)
