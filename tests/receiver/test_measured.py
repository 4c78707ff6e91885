"""Ranges freed of what is known: geometry and the receiver's clock are left, signs and frames."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_sky import observe, sky

from deepgnss.core import frames
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS as C
from deepgnss.receiver.measured import measure, ranges_from
from deepgnss.receiver.pvt import PvtParameters

NAV = sky("GC")
MASKED = PvtParameters(elevation_mask_rad=np.radians(10.0))
LAT, LON = 0.53, 1.99
HERE_E_M = frames.ecef(LAT, LON, 40.0)
V_E_MPS = frames.C_ne(LAT, LON).T @ np.array([12.0, -7.0, 0.5])
EPOCH = observe(NAV, HERE_E_M, V_E_MPS, MASKED, clock_s=2e-4, drift_sps=3e-7, isb_s={"C": 45e-9})


def test_what_is_left_is_the_clock() -> None:
    seen = ranges_from(measure(EPOCH, NAV), MASKED, HERE_E_M)
    clock_m = np.array([C * (2e-4 + (45e-9 if s[0] == "C" else 0.0)) for s in seen.satellites])
    np.testing.assert_allclose(seen.misfit_m, clock_m, atol=2e-3)
    np.testing.assert_allclose(
        np.linalg.norm(seen.r_e_m - HERE_E_M, axis=1) + seen.misfit_m, seen.range_m, atol=1e-6
    )


def test_rates_are_relative_velocity_and_drift() -> None:
    seen = ranges_from(measure(EPOCH, NAV), MASKED, HERE_E_M)
    relative = np.einsum("ki,ki->k", seen.unit_e, seen.v_e_mps - V_E_MPS)
    np.testing.assert_allclose(seen.rate_mps, relative + C * 3e-7, atol=1e-3)


def test_an_antenna_nearer_to_a_satellite_has_shorter_ranges() -> None:
    """The range predicted shrinks and the misfit grows by as much (the air above by 3 mm)."""
    seen = ranges_from(measure(EPOCH, NAV), MASKED, HERE_E_M)
    moved = ranges_from(measure(EPOCH, NAV), MASKED, HERE_E_M + 10.0 * seen.unit_e[0])
    assert moved.misfit_m[0] - seen.misfit_m[0] == pytest.approx(10.0, abs=0.01)


def test_low_unhealthy_and_refused_ones_are_left_out() -> None:
    first, second = ranges_from(measure(EPOCH, NAV), MASKED, HERE_E_M).satellites[:2]
    sick = tuple(replace(e, health=1) for e in NAV.ephemerides[first])
    nav = replace(NAV, ephemerides={**NAV.ephemerides, first: sick})
    seen = ranges_from(measure(EPOCH, nav), MASKED, HERE_E_M, {second: "outlier"})
    assert not {first, second} & set(seen.satellites)
    assert len(seen.satellites) < len(EPOCH.observations)  # those below the mask
    assert len(seen.sigma_m) == len(seen.satellites) == len(seen.rate_sigma_mps)
