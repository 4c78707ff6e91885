"""The first estimate: by hand, against the truth within its own σ, and refused where it must be."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from exact_motion import ORIGIN, Curve, ExactMotion, line, wave
from scipy.stats import chi2

from deepgnss.core import attitude, earth
from deepgnss.core.frames import C_ne, ecef
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade
from deepgnss.ins.alignment import Alignment, AlignmentSettings
from deepgnss.ins.error_model import ACCEL_BIAS, ATTITUDE, GYRO_BIAS, WITH_BIASES
from deepgnss.ins.error_state import Estimate, difference
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.imu_errors import ImuErrors
from deepgnss.ins.standstill import StandstillLimits

LAT, LON, HEIGHT = 0.55, 1.99, 60.0
NORTH_M = earth.meridian_radius_m(LAT) + HEIGHT
EAST_M = (earth.transverse_radius_m(LAT) + HEIGHT) * np.cos(LAT)
LEVER_B_M = np.array([0.4, 0.1, -1.2])
TILTED = (0.03, -0.05)  # roll and pitch of the unit in the vehicle
GRADE = ImuGrade(
    name="of the tests",
    gyro_bias_radps=1e-3,
    gyro_drift_radps2_rthz=1e-7,
    gyro_drift_time_s=1000.0,
    gyro_noise_rad_rts=1e-4,
    gyro_scale=1e-3,
    accel_bias_mps2=0.02,
    accel_drift_mps3_rthz=1e-5,
    accel_drift_time_s=1000.0,
    accel_noise_mps_rts=1e-3,
    accel_scale=1e-3,
    velocity_mps=0.05,
    tilt_rad=2e-3,
    heading_rad=1e-2,
)
LIMITS = StandstillLimits(1.0, 0.01, 0.1)


def ramp(start: float, rate: float, slope: float, from_s: float = 0.0) -> Curve:
    """Steady, from an instant on with a constant second derivative."""

    def curve(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        late = np.maximum(t - from_s, 0.0)
        return (
            start + rate * t + 0.5 * slope * late**2,
            rate + slope * late,
            np.where(t > from_s, slope, 0.0),
        )

    return curve


def straight(
    course_rad: float,
    speed_mps: float,
    slope_mps2: float = 0.0,
    from_s: float = 0.0,
    backwards: bool = False,
) -> ExactMotion:
    north, east = np.cos(course_rad), np.sin(course_rad)
    return ExactMotion(
        ramp(LAT, speed_mps * north / NORTH_M, slope_mps2 * north / NORTH_M, from_s),
        ramp(LON, speed_mps * east / EAST_M, slope_mps2 * east / EAST_M, from_s),
        line(HEIGHT),
        line(TILTED[0]),
        line(TILTED[1]),
        line(course_rad + np.pi * backwards),
    )


def circle(speed_mps: float, turn_radps: float, backwards: bool = False) -> ExactMotion:
    """At steady speed to the right, course 0 at the start."""
    hertz, radius_m = turn_radps / (2.0 * np.pi), speed_mps / turn_radps
    return ExactMotion(
        wave(LAT, 0.0, radius_m / NORTH_M, hertz, 0.0),
        wave(LON, 0.0, radius_m / EAST_M, hertz, -np.pi / 2.0),
        line(HEIGHT),
        line(TILTED[0]),
        line(TILTED[1]),
        line(np.pi * backwards, turn_radps),
    )


def swaying(course_rad: float, backwards: bool = False) -> ExactMotion:
    """Speed between 1 and 4 m/s, up and down every six seconds."""
    north, east = np.cos(course_rad), np.sin(course_rad)
    amplitude_m = 1.5 * 6.0 / (2.0 * np.pi)
    return straight(course_rad, 0.0, backwards=backwards)._replace(
        lat=wave(LAT, 2.5 * north / NORTH_M, amplitude_m * north / NORTH_M, 1.0 / 6.0, 0.4),
        lon=wave(LON, 2.5 * east / EAST_M, amplitude_m * east / EAST_M, 1.0 / 6.0, 0.4),
    )


def fixes_of(
    motion: ExactMotion, t_s: FloatArray, rng: np.random.Generator | None, velocities: bool = True
) -> list[GnssFix]:
    """Fixes of the antenna: position 0.5 m, velocity 0.05 m/s, 1σ; without `rng` exact."""
    place, v_n, q_nb = motion.pose(t_s)
    omega_ib_b, _ = motion.sensed(t_s)
    swing_n = attitude.rotate(q_nb, np.cross(omega_ib_b, LEVER_B_M))
    lever_n = attitude.rotate(q_nb, LEVER_B_M)
    position_sigma = 0.5 if velocities else 0.02
    found = []
    for k, t in enumerate(t_s):
        noise = np.zeros((2, 3)) if rng is None else rng.normal(size=(2, 3))
        to_e = C_ne(place[k, 0], place[k, 1]).T
        r_e = ecef(*place[k]) + to_e @ (lever_n[k] + position_sigma * noise[0])
        fix = GnssFix(ORIGIN.plus(float(t)), r_e, position_sigma**2 * np.eye(3))
        if velocities:
            fix = replace(
                fix,
                v_n_mps=v_n[k] + swing_n[k] + 0.05 * noise[1],
                velocity_covariance_n_m2ps2=0.05**2 * np.eye(3),
            )
        found.append(fix)
    return found


@cache
def exact(motion: ExactMotion, seconds: float) -> ImuBlock:
    return motion.increments(np.arange(round(seconds * 100.0) + 1) / 100.0)


def felt_by(
    motion: ExactMotion, seconds: float, rng: np.random.Generator | None
) -> tuple[ImuBlock, FloatArray]:
    """Increments, and the true biases of gyros and accelerometers (6,)."""
    block = exact(motion, seconds)
    if rng is None:
        return block, np.zeros(6)
    block, truth = ImuErrors(GRADE, rng).apply(block)
    return block, np.concatenate([truth.gyro_bias_radps[-1], truth.accel_bias_mps2[-1]])


def align(
    motion: ExactMotion,
    settings: AlignmentSettings,
    seconds: float = 15.0,
    seed: int | None = None,
    from_s: float = 0.0,
    velocities: bool = True,
) -> Estimate | str:
    rng = None if seed is None else np.random.default_rng(seed)
    block, _ = felt_by(motion, seconds, rng)
    fixes = fixes_of(motion, np.arange(0.0, seconds, 0.5), rng, velocities)
    return Alignment(block, fixes, GRADE, settings, LIMITS)(from_s)


def error_of(
    motion: ExactMotion, found: Estimate | str, seconds: float = 15.0, seed: int | None = None
) -> FloatArray:
    assert isinstance(found, Estimate), found
    rng = None if seed is None else np.random.default_rng(seed)
    _, biases = felt_by(motion, seconds, rng)
    truth = motion.state(found.ins.time.since(ORIGIN))
    return difference(
        found.ins, replace(truth, gyro_bias_radps=biases[:3], accel_bias_mps2=biases[3:])
    )


MOTION = AlignmentSettings("motion", LEVER_B_M)
STATIC = AlignmentSettings("static", LEVER_B_M)


# --- in motion ------------------------------------------------------------------------------------

MANOEUVRES = {
    "speeding up": straight(0.7, 3.0, 1.0),
    "braking": straight(-2.5, 16.0, -1.0),
    "turning": circle(6.0, 0.3),
    "turning left": circle(6.0, -0.3),
    "straight and fast": straight(2.0, 15.0),
    "to and fro on the pedal": swaying(0.7),
    "backwards, on and off the pedal": swaying(0.7, backwards=True),
    "backwards, turning": circle(3.0, 0.5, backwards=True),
}


@pytest.mark.parametrize("name", MANOEUVRES)
def test_without_noise_attitude_is_exact(name: str) -> None:
    motion = MANOEUVRES[name]
    error = error_of(motion, align(motion, MOTION))
    assert np.abs(error[ATTITUDE]).max() < 1e-3
    assert np.abs(error[0:3]).max() < 1e-3
    assert np.abs(error[3:6]).max() < 1e-3


@pytest.mark.parametrize("name", MANOEUVRES)
def test_with_noise_errors_are_as_the_covariance_says(name: str) -> None:
    """Normalized squared error of position, velocity, attitude and accelerometer bias, 20 seeds."""
    motion, total, count = MANOEUVRES[name], 0.0, 20
    kept = np.r_[0:9]
    for seed in range(count):
        found = align(motion, MOTION, seed=seed)
        error = error_of(motion, found, seed=seed)
        assert isinstance(found, Estimate)
        assert np.all(np.linalg.eigvalsh(found.P) > 0.0)
        assert np.sqrt(found.P[8, 8]) < 0.2
        P = found.P[np.ix_(kept, kept)]
        total += error[kept] @ np.linalg.solve(P, error[kept])
    low, high = chi2.interval(0.999, 9 * count)
    assert 0.3 * low < total < high  # allowances for slip and axle that this vehicle does not use


def test_velocities_from_positions_where_there_are_none() -> None:
    motion = MANOEUVRES["turning"]
    for seed in range(5):
        found = align(motion, MOTION, seed=seed, velocities=False)
        assert isinstance(found, Estimate)
        assert found.ins.time.since(ORIGIN) > 0.0  # the first fix has no neighbour before it
        error = error_of(motion, found, seed=seed)
        assert np.all(np.abs(error[:9]) < 3.5 * np.sqrt(np.diagonal(found.P))[:9])


def test_slow_and_steady_tells_no_direction() -> None:
    found = align(straight(0.7, 3.0), MOTION)
    assert isinstance(found, str)
    assert "no telling forwards from backwards" in found
    assert "3.0 m/s" in found


def test_at_rest_there_is_no_course() -> None:
    found = align(straight(0.7, 0.0), MOTION)
    assert isinstance(found, str)
    assert "too slow for a course" in found


@pytest.mark.parametrize("aside_deg", [90.0, -90.0])
def test_axes_turned_aside_are_refused(aside_deg: float) -> None:
    motion = swaying(0.7)
    turned = motion._replace(yaw=line(0.7 + np.radians(aside_deg)))
    found = align(turned, MOTION)
    assert isinstance(found, str)
    assert "off the body's forward axis" in found
    assert f"{-aside_deg:.0f} deg" in found


def test_mounting_yaw_is_taken_into_account() -> None:
    mounted = straight(0.7, 3.0, 1.0)._replace(yaw=line(0.7 + 0.3))
    settings = replace(MOTION, mounting_yaw_rad=0.3)
    assert np.abs(error_of(mounted, align(mounted, settings))[ATTITUDE]).max() < 1e-3


def test_a_later_start_is_sought_from_then_on() -> None:
    motion = MANOEUVRES["turning"]
    found = align(motion, MOTION, from_s=5.2)
    assert isinstance(found, Estimate)
    assert found.ins.time.since(ORIGIN) >= 5.2 + 3.0


def test_fixes_across_a_hole_in_the_increments_are_not_used() -> None:
    motion = MANOEUVRES["turning"]
    block = motion.increments(np.arange(1501) / 100.0)
    kept = (block.time_s < 6.0) | (block.time_s > 6.5)
    holed = ImuBlock(
        ORIGIN,
        block.time_s[kept],
        block.dt_s[kept],
        block.dtheta_b_rad[kept],
        block.dv_b_mps[kept],
    )
    fixes = fixes_of(motion, np.arange(0.0, 15.0, 0.5), None)
    found = Alignment(holed, fixes, GRADE, MOTION, LIMITS)(4.0)
    assert isinstance(found, Estimate)
    assert found.ins.time.since(ORIGIN) >= 6.5 + 3.0


# --- at rest --------------------------------------------------------------------------------------


def moving_off(backwards: bool = False) -> ExactMotion:
    return straight(-1.2, 0.0, 1.0, from_s=6.0, backwards=backwards)


@pytest.mark.parametrize("backwards", [False, True])
def test_rest_levels_and_moving_off_gives_the_heading(backwards: bool) -> None:
    motion = moving_off(backwards)
    found = align(motion, STATIC)
    error = error_of(motion, found)
    assert np.abs(error[ATTITUDE]).max() < 2e-3
    assert np.abs(error[GYRO_BIAS]).max() < 1e-6
    assert np.abs(error[0:6]).max() < 2e-3


@pytest.mark.parametrize("backwards", [False, True])
def test_rest_with_noise_is_as_its_covariance_says(backwards: bool) -> None:
    motion, total, count = moving_off(backwards), 0.0, 20
    kept = np.r_[0:12]
    for seed in range(count):
        found = align(motion, STATIC, seed=seed)
        error = error_of(motion, found, seed=seed)
        assert isinstance(found, Estimate)
        P = found.P[np.ix_(kept, kept)]
        total += error[kept] @ np.linalg.solve(P, error[kept])
    low, high = chi2.interval(0.999, 12 * count)
    assert 0.3 * low < total < high


def test_rest_with_a_given_heading_starts_at_rest() -> None:
    motion = moving_off()
    found = align(motion, replace(STATIC, yaw_rad=-1.2), seed=1)
    error = error_of(motion, found, seed=1)
    assert isinstance(found, Estimate)
    assert found.ins.time.since(ORIGIN) < 6.0
    assert abs(error[8]) < 3e-3
    assert np.abs(error[GYRO_BIAS]).max() < 2e-4


def test_levelling_ties_tilt_to_the_accelerometers_bias() -> None:
    """Once the bias is known the tilt is: the tie has the right sign, axis by axis."""
    motion = moving_off()
    found = align(motion, replace(STATIC, yaw_rad=-1.2), seed=2)
    assert isinstance(found, Estimate)
    error = error_of(motion, found, seed=2)
    P = found.P
    gain = P[ATTITUDE, ACCEL_BIAS] @ np.linalg.inv(P[ACCEL_BIAS, ACCEL_BIAS])
    explained = gain @ error[ACCEL_BIAS]
    assert np.abs(error[6:8]).max() > 3e-4  # 0.02 m/s² over g is 2 mrad
    np.testing.assert_allclose(explained[:2], error[6:8], atol=2e-4)


def test_no_rest_is_said() -> None:
    found = align(circle(6.0, 0.3), STATIC)
    assert isinstance(found, str)
    assert "no rest of 3 s" in found


# --- as given -------------------------------------------------------------------------------------


def test_given_angles_are_taken_at_the_first_fix() -> None:
    motion = straight(0.7, 3.0)
    settings = AlignmentSettings("config", LEVER_B_M, euler_rad=(*TILTED, 0.7))
    found = align(motion, settings)
    error = error_of(motion, found)
    assert isinstance(found, Estimate)
    assert found.ins.time.since(ORIGIN) == pytest.approx(0.0)
    assert np.abs(error[:9]).max() < 1e-6
    sigma = np.sqrt(np.diagonal(found.P))[6:9]
    np.testing.assert_allclose(sigma, [GRADE.tilt_rad, GRADE.tilt_rad, GRADE.heading_rad])
    assert found.P.shape == (WITH_BIASES, WITH_BIASES)


def test_given_angles_hold_at_the_start_only() -> None:
    motion = circle(6.0, 0.3)
    settings = AlignmentSettings("config", LEVER_B_M, euler_rad=(*TILTED, 0.0))
    found = align(motion, settings, from_s=5.0)
    assert np.abs(error_of(motion, found)[ATTITUDE]).max() < 1e-3


def test_without_fixes_there_is_no_start() -> None:
    block = straight(0.7, 3.0).increments(np.arange(101) / 100.0)
    found = Alignment(block, [], GRADE, MOTION, LIMITS)(0.0)
    assert isinstance(found, str)
    assert "0 GNSS fixes" in found
