"""Fixes whose errors last: many together tell no more than one."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.core.time import GpsTime
from deepgnss.ins.fixes import GnssFix, with_lasting_errors

FIX = GnssFix(GpsTime(2290, 0.0), np.zeros(3), np.diag([1.0, 4.0, 9.0]), np.ones(3), np.eye(3))


def test_a_mean_of_weighed_fixes_is_as_good_as_errors_that_last_allow() -> None:
    """A mean over 100 s of errors of √(σ² + 1) m that last 10 s: variance (σ² + 1)·2·10/100."""
    weighed = with_lasting_errors(FIX, 1.0, 0.0, 10.0, 0.1)
    mean_of = 100.0 / 0.1
    expected = (np.diag(FIX.covariance_n_m2) + 1.0) * 2.0 * 10.0 / 100.0
    assert np.diag(weighed.covariance_n_m2) / mean_of == pytest.approx(expected)
    assert weighed.velocity_covariance_n_m2ps2 == pytest.approx(np.eye(3))


def test_fixes_far_apart_keep_their_own_sigma() -> None:
    weighed = with_lasting_errors(FIX, 0.0, 0.5, 10.0, 30.0)
    assert weighed.covariance_n_m2 == pytest.approx(FIX.covariance_n_m2)
    assert weighed.velocity_covariance_n_m2ps2 == pytest.approx(1.25 * np.eye(3))
