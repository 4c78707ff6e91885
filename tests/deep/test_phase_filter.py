"""The filter of the phases: its covariance goes the way its state goes; who does not fit goes."""

from __future__ import annotations

import numpy as np

from deepgnss.core.records import FloatArray, Oscillator
from deepgnss.deep.phase_filter import PhaseFilter, common_jump, sound

INERTIAL, ARCS, SECONDS = 15, 3, 0.1
OSCILLATOR = Oscillator("TCXO", 1e-21, 1e-20, 2e-20, 1e-10)


def carried(mean: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
    """State and covariance a tag later, over a leg that is always the same."""
    rng = np.random.default_rng(1)
    H_begin, H_end = rng.normal(size=(2, 3, INERTIAL))
    Phi = np.eye(INERTIAL) + 0.01 * rng.normal(size=(INERTIAL, INERTIAL))
    known = made()
    known.mean, known.P = mean.copy(), P.copy()
    known.carry(
        H_begin,
        H_end,
        Phi,
        1e-4 * np.eye(INERTIAL),
        SECONDS,
        clock_shaken_m2=1e-6,
        arcs_walk_m2=1e-7,
        rates_walk_m2ps2=np.array([1e-8, 1e-8, 0.0]),
    )
    return known.mean, known.P


def made() -> PhaseFilter:
    """A filter with some arcs."""
    known = PhaseFilter(np.eye(INERTIAL), OSCILLATOR, 0.0, 1.0)
    few = np.ones(ARCS)
    known.begin(few, 1e-4 * few, 1e-6 * few, np.eye(3), few)
    return known


def test_covariance_is_carried_as_the_state_is_and_noise_does_not_depend_on_it() -> None:
    size = made().mean.size
    F = np.column_stack([carried(one, np.eye(size))[0] for one in np.eye(size)])
    own = size - 2 * ARCS
    assert np.allclose(F[own::2, own + 1 :: 2], SECONDS * np.eye(ARCS))  # b grows by r
    rng = np.random.default_rng(2)
    added = []
    for _ in range(2):
        root = rng.normal(size=(size, size))
        P = root @ root.T
        added.append(carried(np.zeros(size), P)[1] - F @ P @ F.T)
    assert np.allclose(added[0], added[1], atol=1e-9)
    assert np.linalg.eigvalsh(0.5 * (added[0] + added[0].T)).min() > -1e-9


def test_phases_that_agree_stay_and_one_that_does_not_goes() -> None:
    off_m, covariance = np.array([0.01, -0.01, 0.3, 0.0]), 1e-4 * np.eye(4)
    assert sound(off_m, covariance, 4.0).tolist() == [True, True, False, True]
    assert common_jump(off_m, covariance, 5.0) is None


def test_what_most_phases_have_in_common_is_a_jump() -> None:
    jumped_m = 0.5 + np.array([0.01, -0.01, 0.0, -0.5])
    assert common_jump(jumped_m, 1e-4 * np.eye(4), 5.0) == np.median(jumped_m)
