"""The navigator: blocks and cuts do not matter, predictions against the truth, gaps, feedback."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from exact_motion import ORIGIN, ExactMotion, drive

from deepgnss.core import attitude
from deepgnss.core.errors import NumericalError
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.ins.error_model import (
    WITH_BIASES,
    WITH_SCALES,
    InitialSigmas,
    initial_covariance,
    process_noise,
)
from deepgnss.ins.error_state import Estimate, Layout, corrected, difference
from deepgnss.ins.increments import between, rows
from deepgnss.ins.navigator import InsNavigator
from deepgnss.ins.trajectory import Trajectory

GRADE = ImuGrade(
    name="of the tests",
    gyro_bias_radps=1e-4,
    gyro_drift_radps2_rthz=1e-7,
    gyro_drift_time_s=1000.0,
    gyro_noise_rad_rts=5e-5,
    gyro_scale=1e-3,
    accel_bias_mps2=0.01,
    accel_drift_mps3_rthz=1e-5,
    accel_drift_time_s=1000.0,
    accel_noise_mps_rts=1e-3,
    accel_scale=1e-3,
    velocity_mps=0.05,
    tilt_rad=1e-3,
    heading_rad=1e-2,
)
LEVER_B_M = np.array([0.4, 0.1, -1.2])


def _navigator(motion: ExactMotion, layout: Layout | None = None) -> InsNavigator:
    layout = layout or Layout()
    P = np.eye(layout.size)
    P[: layout.inertial, : layout.inertial] = initial_covariance(
        GRADE, InitialSigmas(1.0, 0.1, 1e-3, 1e-2), layout.inertial
    )
    estimate = Estimate(layout, motion.state(), np.zeros(layout.extras), P)
    return InsNavigator(estimate, process_noise(GRADE))


def _block(seconds: float, rate_hz: float = 100.0) -> ImuBlock:
    return drive().increments(np.arange(round(seconds * rate_hz) + 1) / rate_hz)


def _position_error_m(trajectory: Trajectory, t_s: FloatArray) -> FloatArray:
    place = drive().pose(t_s)[0]
    predicted = trajectory.predict(t_s)
    ours = zip(predicted.lat_rad, predicted.lon_rad, predicted.height_m, strict=True)
    return np.array([ecef(*p) - ecef(*q) for p, q in zip(ours, place, strict=True)])


# --- blocks and cuts ------------------------------------------------------------------------------


def test_blocks_of_any_size_give_the_same() -> None:
    block, navigator = _block(6.0), _navigator(drive())
    whole, trajectory = navigator.advance(block)
    pieces, first = navigator, 0
    for end in (1, 8, 350, 351, 600):
        pieces, part = pieces.advance(rows(block, first, end))
        assert part.time_s[0] == pytest.approx(block.time_s[first] - block.dt_s[first], abs=1e-9)
        first = end
    assert trajectory.time_s.size == 601
    assert pieces.state.time.since(whole.state.time) == pytest.approx(0.0, abs=1e-9)
    error = difference(pieces.state, whole.state)
    np.testing.assert_allclose(error, 0.0, atol=1e-8)
    # F is held over 50 ms counted from each block's start
    np.testing.assert_allclose(pieces.estimate.P, whole.estimate.P, rtol=1e-2, atol=1e-12)


def test_rows_behind_the_estimate_are_left_out() -> None:
    block, navigator = _block(3.0), _navigator(drive())
    halfway, _ = navigator.advance(block, end_s=1.5)
    end, trajectory = halfway.advance(block)
    assert trajectory.time_s[0] == pytest.approx(1.5, abs=1e-9)
    assert trajectory.time_s.size == 151
    np.testing.assert_allclose(
        difference(end.state, navigator.advance(block)[0].state), 0.0, atol=1e-9
    )


def test_stopping_within_an_increment() -> None:
    """Stops between rows give the state of that instant, and nothing is lost or taken twice."""
    block, navigator = _block(6.0), _navigator(drive())
    stopped = navigator
    for stop in (0.3333, 0.3371, 2.0049, 4.7):
        stopped, trajectory = stopped.advance(block, end_s=stop)
        assert trajectory.time_s[-1] == pytest.approx(stop, abs=1e-9)
        error = difference(stopped.state, drive().state(stop))
        assert np.abs(error[0:3]).max() < 1e-3
        assert np.abs(error[3:6]).max() < 1e-3
        assert np.abs(error[6:9]).max() < 2e-5
    end, _ = stopped.advance(block)
    np.testing.assert_allclose(
        difference(end.state, navigator.advance(block)[0].state), 0.0, atol=1e-4
    )


def test_cutting_keeps_the_sums() -> None:
    block = _block(1.0)
    cuts = [0.0, 0.1234, 0.1299, 0.13, 0.777, 1.0]
    parts = [between(block, a, b) for a, b in pairwise(cuts)]
    assert [part.time_s[-1] for part in parts] == pytest.approx(cuts[1:], abs=1e-12)
    for name in ("dt_s", "dtheta_b_rad", "dv_b_mps"):
        total = sum(getattr(part, name).sum(axis=0) for part in parts)
        np.testing.assert_allclose(total, getattr(block, name).sum(axis=0), rtol=1e-12)
    assert between(block, 2.0, 3.0).time_s.size == 0


def test_nothing_to_advance_through() -> None:
    navigator = _navigator(drive())
    same, trajectory = navigator.advance(_block(1.0), end_s=0.0)
    assert same.state.time == navigator.state.time
    assert trajectory.time_s.size == 1
    np.testing.assert_array_equal(trajectory.Phi, np.eye(WITH_BIASES))


# --- prediction -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_hz", "position_m", "velocity_mps", "phi_rad", "rate_radps"),
    [(50.0, 1e-4, 1e-5, 4e-5, 3e-3), (200.0, 1e-5, 2e-7, 3e-6, 6e-5)],
)
def test_prediction_at_any_instant(
    rate_hz: float, position_m: float, velocity_mps: float, phi_rad: float, rate_radps: float
) -> None:
    _, trajectory = _navigator(drive()).advance(_block(5.0, rate_hz))
    t = np.random.default_rng(1).uniform(0.0, 5.0, 300)
    predicted, (_, v, q) = trajectory.predict(t), drive().pose(t)
    assert np.abs(_position_error_m(trajectory, t)).max() < position_m
    assert np.abs(predicted.v_n_mps - v).max() < velocity_mps
    assert np.abs(attitude.attitude_error_n(predicted.q_nb, q)).max() < phi_rad
    assert np.abs(predicted.omega_ib_b_radps - drive().sensed(t)[0]).max() < rate_radps


def test_prediction_meets_the_rows() -> None:
    _, trajectory = _navigator(drive()).advance(_block(2.0))
    predicted = trajectory.predict(trajectory.time_s)
    np.testing.assert_allclose(predicted.lat_rad, trajectory.lat_rad, atol=1e-15)
    np.testing.assert_allclose(predicted.v_n_mps, trajectory.v_n_mps, atol=1e-13)
    np.testing.assert_allclose(predicted.q_nb, trajectory.q_nb, atol=1e-14)


def test_antenna_is_where_the_lever_arm_puts_it_and_moves_so() -> None:
    """Position by the matrices; velocity against differences of the true positions."""
    _, trajectory = _navigator(drive()).advance(_block(5.0, 200.0))

    def truth(t: FloatArray) -> FloatArray:
        place, _, q = drive().pose(t)
        levers = attitude.rotate(q, LEVER_B_M)
        return np.array(
            [ecef(*p) + C_ne(p[0], p[1]).T @ lever for p, lever in zip(place, levers, strict=True)]
        )

    t = np.linspace(0.3, 4.7, 40)
    antenna = trajectory.antenna(t, LEVER_B_M)
    assert np.abs(antenna.r_e_m - truth(t)).max() < 1e-4
    np.testing.assert_array_equal(trajectory.antenna_place(t, LEVER_B_M), antenna.r_e_m)
    step = 1e-3
    velocity = (truth(t + step) - truth(t - step)) / (2.0 * step)
    assert np.abs(antenna.v_e_mps - velocity).max() < 2e-4
    for k in (0, 20):
        place = drive().pose(t)[0][k]
        np.testing.assert_allclose(
            C_ne(place[0], place[1]) @ antenna.v_e_mps[k], antenna.v_n_mps[k], atol=1e-8
        )


def test_prediction_outside_is_refused() -> None:
    _, trajectory = _navigator(drive()).advance(_block(1.0))
    with pytest.raises(NumericalError, match=r"1\.2000.*0\.0000.*1\.0000"):
        trajectory.predict(np.array([0.5, 1.2]))


# --- covariance -----------------------------------------------------------------------------------


@pytest.mark.parametrize("states", [WITH_BIASES, WITH_SCALES])
def test_small_errors_go_where_phi_says(states: int) -> None:
    """A wrong start, advanced beside the right one, differs by Φ·x after ten lively seconds."""
    block, navigator = _block(10.0), _navigator(drive(), Layout(states))
    end, trajectory = navigator.advance(block)
    sigma = np.sqrt(np.diagonal(navigator.estimate.P))
    for seed in range(3):
        x = 0.1 * sigma * np.random.default_rng(seed).normal(size=states)
        wrong = replace(navigator.estimate, ins=corrected(navigator.state, -x))
        led, _ = replace(navigator, estimate=wrong).advance(block)
        expected = trajectory.Phi @ x
        after = difference(led.state, end.state)[:states]
        scale = np.sqrt(np.diagonal(end.estimate.P))
        np.testing.assert_allclose(after / scale, expected / scale, atol=5e-3)


def test_covariance_follows_phi_and_q_and_extras_keep_their_ties() -> None:
    layout = Layout(WITH_BIASES, odometer=True)
    navigator = _navigator(drive(), layout)
    P = navigator.estimate.P.copy()
    P[3, 15] = P[15, 3] = 0.05  # velocity and odometer scale
    navigator = replace(navigator, estimate=replace(navigator.estimate, P=P))
    end, trajectory = navigator.advance(_block(5.0))
    Phi, Q = np.eye(16), np.zeros((16, 16))
    Phi[:15, :15], Q[:15, :15] = trajectory.Phi, trajectory.Q
    np.testing.assert_allclose(end.estimate.P, Phi @ P @ Phi.T + Q, rtol=1e-9, atol=1e-15)
    assert end.estimate.P[0, 15] == pytest.approx(5.0 * 0.05, rel=1e-2)
    assert trajectory.covariance_time_s == pytest.approx(np.arange(6.0))


def test_covariance_between_its_instants() -> None:
    navigator = _navigator(drive())
    _, coarse = navigator.advance(_block(4.0))
    _, fine = replace(navigator, covariance_step_s=0.05).advance(_block(4.0))
    t = np.array([0.0, 0.33, 2.71, 4.0])
    coarse_sigma, fine_sigma = (
        np.sqrt(np.diagonal(trajectory.covariance(t), axis1=1, axis2=2))
        for trajectory in (coarse, fine)
    )
    np.testing.assert_allclose(coarse_sigma, fine_sigma, rtol=0.05)
    np.testing.assert_allclose(coarse_sigma[[0, 3]], fine_sigma[[0, 3]], rtol=1e-6)


def test_antenna_covariance_is_what_perturbed_starts_say() -> None:
    """σ of the antenna along each axis from the slope of position and velocity in the errors."""
    block, navigator = _block(1.0), _navigator(drive())
    _, trajectory = navigator.advance(block)
    t = np.array([0.0])
    P = navigator.estimate.P
    nominal = trajectory.antenna(t, LEVER_B_M)
    to_n = C_ne(navigator.state.lat_rad, navigator.state.lon_rad)
    slope = np.zeros((6, WITH_BIASES))
    for k in range(WITH_BIASES):
        step = 1.0 if k < 3 else 1e-4  # metres, or m/s and rad
        x = np.zeros(WITH_BIASES)
        x[k] = step
        wrong = replace(navigator.estimate, ins=corrected(navigator.state, -x))
        _, led = replace(navigator, estimate=wrong).advance(block)
        antenna = led.antenna(t, LEVER_B_M)
        slope[:3, k] = to_n @ (antenna.r_e_m - nominal.r_e_m)[0] / step
        slope[3:, k] = (antenna.v_n_mps - nominal.v_n_mps)[0] / step
    np.testing.assert_allclose(  # a metre turns the frame by 1/R, 1.6e-7
        trajectory.antenna_covariance(t, LEVER_B_M)[0], slope @ P @ slope.T, rtol=2e-3, atol=3e-7
    )


# --- feedback -------------------------------------------------------------------------------------


def test_feedback_takes_the_error_off() -> None:
    navigator = _navigator(drive())
    x = np.random.default_rng(2).normal(size=WITH_BIASES) * 1e-3
    P = 0.5 * navigator.estimate.P
    fed = navigator.corrected(x, P)
    np.testing.assert_allclose(
        difference(navigator.state, fed.state)[:WITH_BIASES], x, rtol=1e-3, atol=1e-8
    )
    assert fed.estimate.P is P
    assert fed.before is navigator.before


# --- gaps -----------------------------------------------------------------------------------------


def _with_gap(seconds: float, start_s: float, length_s: float) -> ImuBlock:
    block = _block(seconds)
    kept = (block.time_s <= start_s + 1e-6) | (block.time_s > start_s + length_s + 1e-6)
    return ImuBlock(
        ORIGIN,
        block.time_s[kept],
        block.dt_s[kept],
        block.dtheta_b_rad[kept],
        block.dv_b_mps[kept],
    )


@pytest.mark.parametrize("length_s", [0.01, 0.3, 1.0])
def test_a_short_gap_is_bridged_and_said(length_s: float) -> None:
    navigator = _navigator(drive())
    end, trajectory = navigator.advance(_with_gap(4.0, 2.0, length_s))
    (gap,) = trajectory.bridged
    assert (gap.start_s, gap.length_s) == pytest.approx((2.0, length_s), abs=1e-9)
    assert trajectory.outage is None
    assert trajectory.time_s.size == 401  # bridged at the usual rate
    complete, _ = navigator.advance(_block(4.0))
    error = difference(end.state, complete.state)[:9]
    added = np.diagonal(end.estimate.P - complete.estimate.P)[:9]
    assert np.all(np.abs(error) < 3.0 * np.sqrt(np.maximum(added, 1e-10)))


def test_a_gap_between_blocks_is_a_gap_too() -> None:
    block, navigator = _with_gap(4.0, 2.0, 0.3), _navigator(drive())
    whole, _ = navigator.advance(block)
    first, _ = navigator.advance(rows(block, 0, 200))
    second, trajectory = first.advance(rows(block, 200, block.time_s.size))
    assert [gap.length_s for gap in trajectory.bridged] == pytest.approx([0.3])
    np.testing.assert_allclose(difference(second.state, whole.state), 0.0, atol=1e-9)


def test_a_long_gap_is_an_outage() -> None:
    end, trajectory = _navigator(drive()).advance(_with_gap(5.0, 2.0, 1.5))
    assert trajectory.outage is not None
    assert (trajectory.outage.start_s, trajectory.outage.end_s) == pytest.approx((2.0, 3.5))
    assert trajectory.time_s[-1] == pytest.approx(2.0)
    assert end.state.time.since(ORIGIN) == pytest.approx(2.0)
    error = difference(end.state, drive().state(2.0))
    assert np.abs(error[:3]).max() < 1e-3
