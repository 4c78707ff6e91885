"""Every measurement model against perturbation of the state it predicts from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from deepgnss.core.attitude import quaternion_from_euler, rotation_matrix
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray, InsState, NavSolution
from deepgnss.core.time import GpsTime
from deepgnss.ins import measurements as models
from deepgnss.ins.error_state import Estimate, Layout, corrected, difference
from deepgnss.ins.fixes import fix_of
from deepgnss.ins.measurements import Measurement, body_point
from deepgnss.ins.ranging import RangeObservation, pseudorange, range_rate

LAYOUT = Layout(21, odometer=True, systems=("G", "C", "E"))
LEVER_B_M = np.array([0.4, 0.1, -1.2])
AXLE_B_M = np.array([-1.1, 0.2, 0.6])
C_VB = rotation_matrix(quaternion_from_euler(np.array([0.02, -0.05, 0.08])))
RATE_B_RADPS = np.array([0.1, -0.2, 0.6])  # as the gyros read it
NOMINAL = Estimate(
    LAYOUT,
    InsState(
        GpsTime(2200, 0.0),
        0.7,
        2.0,
        120.0,
        np.array([12.0, -7.0, 0.5]),
        quaternion_from_euler(np.array([0.05, -0.1, 2.5])),
        np.array([0.01, -0.02, 0.03]),
        np.array([0.1, 0.2, -0.1]),
        np.zeros(3),  # a scale estimate s would divide slopes by 1 + s, which H leaves out
        np.zeros(3),
    ),
    np.array([0.02, 5e4, 120.0, 8.0, -3.0]),
    np.eye(LAYOUT.size),
)
SATELLITE = RangeObservation(
    "C06",
    "C",
    ecef(0.7, 2.0, 0.0) + C_ne(0.7, 2.0).T @ np.array([1.1e7, -0.8e7, -1.5e7]),
    np.array([2500.0, -800.0, 1900.0]),
    2.01e7,
    3.0,
    -200.0,
    0.1,
)


def rate(ins: InsState) -> FloatArray:
    return (RATE_B_RADPS - ins.gyro_bias_radps) / (1.0 + ins.gyro_scale)


def antenna(estimate: Estimate) -> models.Point:
    return body_point(estimate.ins, rate(estimate.ins), LEVER_B_M, estimate.layout)


MODELS: dict[str, Callable[[Estimate], Measurement]] = {
    "position": lambda e: models.position(
        e.ins, antenna(e), ecef(0.7, 2.0, 118.0), np.diag([1.0, 2.0, 3.0])
    ),
    "velocity": lambda e: models.velocity(antenna(e), np.array([11.0, -6.0, 0.0]), np.eye(3)),
    "course": lambda e: models.course(e.ins, 2.4, 0.05, e.layout, 0.01),
    "non-holonomic": lambda e: models.nonholonomic(
        e.ins, rate(e.ins), AXLE_B_M, C_VB, np.array([0.1, 0.2]), e.layout
    ),
    "odometer": lambda e: models.odometer(e, rate(e.ins), AXLE_B_M, C_VB, 13.0, 0.1),
    "zero velocity": lambda e: models.zero_velocity(e.ins, 0.05, e.layout),
    "zero rotation": lambda e: models.zero_rotation(e.ins, rate(e.ins), 0.01, e.layout),
    "pseudorange": lambda e: pseudorange(e, antenna(e), SATELLITE),
    "range rate": lambda e: range_rate(e, antenna(e), SATELLITE, -200.0),
}
STEP = np.array(
    [5.0] * 3
    + [0.5] * 3
    + [1e-4] * 3
    + [1e-3] * 3
    + [1e-2] * 3
    + [1e-3] * 6
    + [1e-2, 10.0, 1.0, 1.0, 1.0]
)


@pytest.mark.parametrize("kind", MODELS)
def test_slope_is_what_perturbation_shows(kind: str) -> None:
    model = MODELS[kind]
    H = model(NOMINAL).H
    assert model(NOMINAL).kind == kind
    assert H.shape == (model(NOMINAL).z.size, LAYOUT.size)
    for column in range(LAYOUT.size):
        error = np.zeros(LAYOUT.size)
        error[column] = STEP[column]
        up = model(NOMINAL.corrected(-error, NOMINAL.P)).z
        down = model(NOMINAL.corrected(error, NOMINAL.P)).z
        # 2e-5: directions of NED and the frame's rate turn with the position and velocity (1/R).
        np.testing.assert_allclose(
            (up - down) / (2 * STEP[column]), H[:, column], rtol=1e-4, atol=2e-5, err_msg=column
        )


def test_lever_arm_to_an_antenna_above_a_turning_vehicle() -> None:
    """Level, heading east, turning right: an antenna 1 m ahead moves south, 1 m up not at all."""
    ins = InsState(
        GpsTime(2200, 0.0),
        0.0,
        0.0,
        0.0,
        np.zeros(3),
        quaternion_from_euler(np.array([0.0, 0.0, np.pi / 2])),
        *(np.zeros(3) for _ in range(4)),
    )
    turning = np.array([0.0, 0.0, 0.5])
    ahead = body_point(ins, turning, np.array([1.0, 0.0, 0.0]), Layout())
    above = body_point(ins, turning, np.array([0.0, 0.0, -1.0]), Layout())
    np.testing.assert_allclose(ahead.v_n_mps, [-0.5, 0.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(above.v_n_mps, 0.0, atol=1e-4)
    np.testing.assert_allclose(ahead.r_e_m, [6_378_137.0, 1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(above.r_e_m, [6_378_138.0, 0.0, 0.0], atol=1e-6)


def test_innovations_are_predicted_minus_measured() -> None:
    truth = NOMINAL
    high = NOMINAL.corrected(-np.eye(LAYOUT.size)[0] * 3.0, NOMINAL.P)  # 3 m too far north
    point = antenna(truth)
    z = models.position(high.ins, antenna(high), point.r_e_m, np.eye(3)).z
    np.testing.assert_allclose(z, [3.0, 0.0, 0.0], atol=1e-4)
    late = NOMINAL.corrected(-np.eye(LAYOUT.size)[LAYOUT.clock] * 3.0, NOMINAL.P)
    z_range = pseudorange(late, antenna(late), SATELLITE).z - pseudorange(truth, point, SATELLITE).z
    np.testing.assert_allclose(z_range, [3.0], atol=1e-6)


def test_course_differences_are_taken_the_short_way_round() -> None:
    yaw_rad = np.arctan2(*rotation_matrix(NOMINAL.ins.q_nb)[[1, 0], 0])
    z = models.course(NOMINAL.ins, yaw_rad - 2.0 * np.pi + 0.1, 0.1, LAYOUT).z
    np.testing.assert_allclose(z, [-0.1], atol=1e-12)


def test_range_rate_is_the_slope_of_the_range() -> None:
    """Signs and frames of both together: move everything along for 10 ms and difference."""
    dt_s = 0.01
    point = antenna(NOMINAL)
    v_e = C_ne(NOMINAL.ins.lat_rad, NOMINAL.ins.lon_rad).T @ point.v_n_mps
    predicted = [
        np.linalg.norm(SATELLITE.r_e_m + t * SATELLITE.v_e_mps - point.r_e_m - t * v_e)
        for t in (-dt_s, dt_s)
    ]
    slope = (predicted[1] - predicted[0]) / (2 * dt_s)
    z = range_rate(NOMINAL, point, SATELLITE, slope).z
    np.testing.assert_allclose(z, [NOMINAL.extra(LAYOUT.clock + 1)], atol=1e-4)


def test_difference_undoes_correction() -> None:
    rng = np.random.default_rng(1)
    error = rng.normal(size=21) * STEP[:21]
    np.testing.assert_allclose(
        difference(NOMINAL.ins, corrected(NOMINAL.ins, error)), error, rtol=1e-5, atol=1e-7
    )


def test_fix_of_a_solution_turns_ecef_into_ned() -> None:
    """At longitude 90° on the equator: north is z, east is −x, down is −y of ECEF."""
    solution = NavSolution(
        GpsTime(2200, 5.0), True, "", ecef(0.0, np.pi / 2, 0.0), np.array([1.0, 2.0, 3.0]),
        0.0, 0.0, {}, np.diag([1.0, 4.0, 9.0, 1.0]), np.diag([0.1, 0.4, 0.9, 1.0]),
        {}, (), {}, {}, {},
    )  # fmt: skip
    fix = fix_of(solution)
    np.testing.assert_allclose(fix.v_n_mps, [3.0, -1.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(fix.covariance_n_m2, np.diag([9.0, 1.0, 4.0]), atol=1e-9)
    np.testing.assert_allclose(fix.velocity_covariance_n_m2ps2, np.diag([0.9, 0.1, 0.4]), atol=1e-9)
