"""Velocities measured a while ago and carried on: whose errors they show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from driving import FSAS, MTI_G, START, Drive, drive, sensed, started

from deepgnss.core.attitude import euler_rad, quaternion_from_euler
from deepgnss.ins.error_model import InitialSigmas, initial_covariance, process_noise
from deepgnss.ins.error_state import Estimate, Layout
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.increments import joined, rows
from deepgnss.ins.integration import Coupling, Instant, Settings
from deepgnss.ins.measurements import Measurement
from deepgnss.ins.navigator import InsNavigator
from deepgnss.ins.past import Past
from deepgnss.sim.imu.increments import increments
from deepgnss.sim.motion.attitude import Steady
from deepgnss.sim.motion.paths import Line
from deepgnss.sim.motion.profile import acceleration_profile
from deepgnss.sim.motion.vehicle import Vehicle

H_NOW = np.hstack([np.zeros((3, 3)), np.eye(3), np.zeros((3, 9))])
LASTING = (6, 7, 12, 13, 14)  # tilts and biases of accelerometers: what lets a velocity run away


def test_a_velocity_carried_on_is_seen_with_the_errors_of_then() -> None:
    """H at the end of a leg gives the error at its begin; what lies between is of second order."""
    truth = drive(60.0)
    block, errors = sensed(truth, MTI_G, 3)
    rng = np.random.default_rng(3)
    navigator = InsNavigator(started(truth, MTI_G, errors, Layout(), rng), process_noise(MTI_G))
    _, leg = navigator.advance(rows(block, 0, 20), 0.2)
    now = Measurement("velocity", np.zeros(3), H_NOW, np.eye(3))
    P = np.diag(np.full(15, 1e-4))
    then = Past().aged(now, 0.2, leg, P)
    for k in LASTING:
        x = 1e-2 * np.eye(15)[k]
        grown = (leg.Phi @ x)[3:6]
        assert np.linalg.norm(then.H @ leg.Phi @ x) < 0.05 * np.linalg.norm(grown)
    G = H_NOW - then.H
    np.testing.assert_allclose(then.R - np.eye(3), G @ P @ G.T / 12.0)  # ages of 0.1 to 0.3 s
    assert Past().aged(now, 0.0, leg, P) is now


def test_growth_is_that_of_the_steps_in_between_and_corrections_are_known() -> None:
    """Steps that differ, errors corrected at their ends: what is said is of the error left now."""
    truth = drive(60.0)
    navigator = InsNavigator(
        started(truth, MTI_G, sensed(truth, MTI_G, 3)[1], Layout(), np.random.default_rng(3)),
        process_noise(MTI_G),
    )
    _, leg = navigator.advance(rows(truth.block, 0, 10), 0.1)
    rng = np.random.default_rng(4)
    past, delta = Past(), np.zeros(15)
    delta[6:] = rng.normal(size=9)
    then, taken_mps = np.zeros(3), np.zeros(3)
    for k, push in enumerate((7.0, 0.0, 1.0, 5.0, 20.0)):  # the first is not in between any more
        Phi = np.eye(15)
        Phi[3:6, 6:9] = push * rng.normal(size=(3, 3))
        step = replace(leg, Phi=Phi)
        delta = Phi @ delta
        if k == 4:
            break
        x = np.concatenate([np.zeros(3), rng.normal(size=12)])
        delta = delta - x
        past.note(step, x)
        then = delta[3:6].copy() if k == 0 else then
        taken_mps = np.zeros(3) if k == 0 else taken_mps + x[3:6]
    seen = Measurement("velocity", then - taken_mps, H_NOW, np.eye(3))  # of then, and carried on
    aged = past.aged(seen, 0.4, step, np.zeros((15, 15)))
    np.testing.assert_allclose(aged.z, aged.H @ delta, atol=1e-9)
    assert np.abs(seen.z - H_NOW @ delta).max() > 1.0


AGE_S, EPOCH_S, ACCELERATION_MPS2 = 0.3, 0.1, 245.0


@pytest.mark.parametrize("off_deg", [-0.5, 0.5])
def test_a_manoeuvre_s_begin_turns_a_wrong_heading_the_right_way(off_deg: float) -> None:
    """25 g after rest, by Dopplers of 0.3 s ago: they know little of the acceleration of now."""
    path = Line(
        (np.sqrt(0.5), np.sqrt(0.5), 0.0), acceleration_profile([(1.0, ACCELERATION_MPS2)], 980.0)
    )
    vehicle = Vehicle(0.53, 1.99, 30.0, path, Steady(yaw_rad=np.pi / 4))
    truth = Drive(vehicle, joined(*increments(vehicle, START, 200.0, 500, highest_hz=20.0)))
    sigmas = InitialSigmas(1.0, 0.05, np.radians(0.1), np.radians(0.6))
    nominal = truth.state(0.0)
    q_nb = quaternion_from_euler(np.array([0.0, 0.0, np.pi / 4 + np.radians(off_deg)]))
    start = Estimate(
        Layout(), replace(nominal, q_nb=q_nb), np.zeros(0), initial_covariance(FSAS, sigmas, 15)
    )
    run = Coupling(truth.block, process_noise(FSAS), Settings(np.zeros(3)))
    run.begin(start)
    rng = np.random.default_rng(5)
    gained: list[np.ndarray] = []
    largest_deg = 0.0
    for k in range(1, 21):
        now_s = k * EPOCH_S
        leg = run.look_ahead(now_s)
        gained = [*gained, leg.v_n_mps[-1] - leg.v_n_mps[0]][-round(AGE_S / EPOCH_S) :]
        v_n_mps = truth.state(max(now_s - AGE_S, 0.0)).v_n_mps + sum(gained)
        fix = GnssFix(
            START.plus(now_s),
            vehicle.pose(np.array([now_s])).r_e_m[0],
            100.0**2 * np.eye(3),
            v_n_mps + 0.05 * rng.normal(size=3),
            0.05**2 * np.eye(3),
            AGE_S,
        )
        assert run.through([Instant(now_s, fix)]) is None
        heading_rad = euler_rad(run.estimate.ins.q_nb)[2]
        largest_deg = max(largest_deg, abs(np.degrees(heading_rad) - 45.0))
    assert all(i.accepted for i in run.innovations if i.kind == "velocity")
    assert largest_deg < 1.1 * abs(off_deg)
    assert abs(np.degrees(heading_rad) - 45.0) < 0.2 * abs(off_deg)
