"""Wheel speed: distance rolled along the forward axis, with the errors asked for."""

import numpy as np
import pytest

from deepgnss.sim.imu.odometer import OdometerErrors, wheel_speed
from deepgnss.sim.motion.attitude import EllipseAttitude, Steady
from deepgnss.sim.motion.paths import Ellipse, Line
from deepgnss.sim.motion.profile import acceleration_profile, smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle

PLACE = (0.9, 0.2, 100.0)
IDEAL = OdometerErrors()


def rng():
    return np.random.default_rng(1)


def pulling_away(yaw_rad=0.0):
    path = Line((1.0, 0.0, 0.0), acceleration_profile([(1.0, 2.0), (4.033, 0.0)], 10.0))
    return Vehicle(*PLACE, path, Steady(yaw_rad=yaw_rad))


def test_speeds_are_means_over_the_time_before_and_add_up_to_the_distance():
    body = pulling_away()
    time_s, speed_mps = wheel_speed(body, 10.0, 8.0, IDEAL, rng())
    np.testing.assert_allclose(time_s, np.arange(1, 81) / 10.0)
    r_e_m = body.point(np.append(0.0, time_s)).r_m
    np.testing.assert_allclose(speed_mps / 10.0, np.linalg.norm(np.diff(r_e_m, axis=0), axis=1),
                               atol=1e-8)  # fmt: skip
    assert speed_mps[5] == 0.0 and speed_mps[-1] == pytest.approx(6.066, abs=1e-3)


def test_backwards_is_negative_and_sideways_is_nothing():
    _, backwards = wheel_speed(pulling_away(yaw_rad=np.pi), 5.0, 8.0, IDEAL, rng())
    assert backwards[-1] == pytest.approx(-6.066, abs=1e-3)
    _, sideways = wheel_speed(pulling_away(yaw_rad=0.5 * np.pi), 5.0, 8.0, IDEAL, rng())
    assert np.abs(sideways).max() < 1e-9


def test_on_a_circle_it_is_arc_over_time():
    ellipse = Ellipse(50.0, 50.0, smooth_profile([(0.0, 0.2)], flat=2))
    body = Vehicle(*PLACE, ellipse, EllipseAttitude(ellipse, bank=0.5))
    _, speed_mps = wheel_speed(body, 4.0, 20.0, IDEAL, rng())
    np.testing.assert_allclose(speed_mps, 10.0, rtol=1e-9)


def test_errors_are_those_asked_for():
    body = pulling_away()
    _, true = wheel_speed(body, 100.0, 30.0, IDEAL, rng())
    _, scaled = wheel_speed(body, 100.0, 30.0, OdometerErrors(scale_error=0.01), rng())
    np.testing.assert_allclose(scaled, true * 1.01, atol=1e-9)
    _, noisy = wheel_speed(body, 100.0, 30.0, OdometerErrors(noise_mps=0.05), rng())
    assert np.std(noisy - true) == pytest.approx(0.05, rel=0.05)
    _, counted = wheel_speed(body, 100.0, 30.0, OdometerErrors(pulse_m=0.02), rng())
    pulses = counted / 100.0 / 0.02
    np.testing.assert_allclose(pulses, np.rint(pulses), atol=1e-6)
    rolled = np.cumsum(counted - true) / 100.0
    assert rolled.min() >= -0.02 and rolled.max() <= 1e-9  # never more than a pulse behind
