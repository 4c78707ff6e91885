"""The first estimate: from given angles, from rest, or in motion.

All start at a GNSS fix, whose position and velocity are led over the lever arm to the unit. The
accelerometers' bias is levelled into the tilt; the covariance says so (tilt and bias are tied),
and the filter can part them later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple

import numpy as np

from deepgnss.core.attitude import (
    quaternion_conjugate,
    quaternion_from_euler,
    quaternion_from_rotation_vector,
    quaternion_product,
    rotate,
    rotation_matrix,
)
from deepgnss.core.earth import earth_rate_n
from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray, ImuBlock, ImuGrade, InsState
from deepgnss.ins.coarse import (
    SURE_YAW_RAD,
    CoarseAttitude,
    Reckoned,
    Track,
    free_fall_mps2,
    from_motion,
    heading_by_course,
    reckoned,
)
from deepgnss.ins.error_model import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    InitialSigmas,
    initial_covariance,
)
from deepgnss.ins.error_state import Estimate, Layout
from deepgnss.ins.fixes import GnssFix
from deepgnss.ins.increments import LONGEST_BRIDGE_S, between, gaps
from deepgnss.ins.standstill import (
    StandstillLimits,
    fastest_at_rest_mps,
    standing,
    standstill_limits,
)

LARGEST_TILT_RAD: Final = 0.1
"""1σ of tilt with which the error model is still linear enough."""

LARGEST_YAW_RAD: Final = 0.2
"""1σ of yaw likewise."""


@dataclass(frozen=True, slots=True)
class AlignmentSettings:
    """How the first attitude is found.

    method: `config` takes `euler_rad` (roll, pitch, yaw); `static` levels at rest, yaw from
    `yaw_rad` or, once it is None, from the way the vehicle then moves off; `motion` needs no rest.
    """

    method: Literal["config", "static", "motion"]
    lever_b_m: FloatArray  # (3,) IMU → antenna phase centre
    euler_rad: tuple[float, float, float] | None = None
    yaw_rad: float | None = None
    mounting_yaw_rad: float = 0.0  # of the body axes against the vehicle's forward axis
    window_s: float = 8.0  # of motion
    rest_s: float = 3.0  # shortest rest
    move_off_s: float = 30.0  # longest way from rest to a course
    layout: Layout = field(default_factory=Layout)
    extras: FloatArray = field(default_factory=lambda: np.zeros(0))  # values behind the inertial
    extra_sigmas: FloatArray = field(default_factory=lambda: np.zeros(0))


class _Found(NamedTuple):
    """An attitude at a fix, with what else was learnt on the way."""

    k: int  # of the fix
    q_nb: FloatArray
    covariance_rad2: FloatArray  # (3, 3), accelerometer bias left out
    gyro_bias_radps: FloatArray
    gyro_sigma_radps: float | None  # None: that of the grade
    levelled: bool  # tilt holds the accelerometers' bias


class Alignment:
    """Looks for the first estimate at or after an instant; after the first try, in motion only.

    Given angles, and rest before the start, say nothing of a start anew in mid-drive.
    """

    def __init__(
        self,
        block: ImuBlock,
        fixes: Sequence[GnssFix],
        grade: ImuGrade,
        settings: AlignmentSettings,
        limits: StandstillLimits | None = None,
    ) -> None:
        self._block, self._fixes = block, list(fixes)
        self._grade, self._settings = grade, settings
        self._limits = limits
        self._track = _track(self._fixes, block)

    def __call__(self, from_s: float) -> Estimate | str:
        """Estimate at the first chance from `from_s` on (since the block's origin), or why none."""
        if self._block.time_s.size == 0:
            return "no increments"
        if len(self._fixes) < 3:
            return f"{len(self._fixes)} GNSS fixes: three needed at least"
        start_s = float(self._block.time_s[0] - self._block.dt_s[0])
        method = self._settings.method if from_s <= start_s + 1e-3 else "motion"
        ways = {"config": self._as_given, "static": self._from_rest, "motion": self._in_motion}
        reason = "no GNSS fix within the increments"
        for found in ways[method](from_s):
            if not isinstance(found, str):
                return self._estimate(found)
            reason = found
        return reason

    # --- the three ways: candidates in order of time, or why they are none ------------------------

    def _as_given(self, from_s: float) -> Iterator[_Found | str]:
        if self._settings.euler_rad is None:
            yield "no roll, pitch and yaw given"
            return
        q_nb = quaternion_from_euler(np.array(self._settings.euler_rad))
        sigma = np.array([self._grade.tilt_rad, self._grade.tilt_rad, self._grade.heading_rad])
        for k in self._within(from_s):
            yield _Found(k, q_nb, np.diag(sigma**2), np.zeros(3), None, False)

    def _in_motion(self, from_s: float) -> Iterator[_Found | str]:
        time_s, settings = self._track.time_s, self._settings
        for k in self._within(from_s):
            first = int(np.searchsorted(time_s, max(from_s, time_s[k] - settings.window_s)))
            if k - first < 3 or time_s[k] - time_s[first] < 0.4 * settings.window_s:
                yield "too few GNSS fixes in a row"
                continue
            felt = self._reckoned(time_s[first : k + 1], np.zeros(3))
            if isinstance(felt, str):
                yield felt
                continue
            track = Track(*(part[first : k + 1] for part in self._track))
            fall = self._fall(k)
            coarse = from_motion(
                track, felt, fall, self._grade.gyro_bias_radps, settings.mounting_yaw_rad
            )
            if isinstance(coarse, str):
                yield coarse
                continue
            passed_s = float(time_s[k] - time_s[first])
            drift2 = (0.5 * passed_s * self._grade.gyro_bias_radps) ** 2 * np.eye(3)
            yield _checked(
                _Found(k, coarse.q_nb, coarse.covariance_rad2 + drift2, np.zeros(3), None, True)
            )

    def _from_rest(self, from_s: float) -> Iterator[_Found | str]:
        rate_hz = 1.0 / float(np.median(self._block.dt_s))
        limits = self._limits or standstill_limits(self._grade, rate_hz)
        found_rest = False
        for since_s, until_s in _rests(self._block, limits, from_s, self._settings.rest_s):
            inside = (self._track.time_s >= since_s) & (self._track.time_s <= until_s)
            speed_mps = np.linalg.norm(self._track.v_n_mps[inside], axis=1)
            if np.any(speed_mps > fastest_at_rest_mps(self._track.sigma_mps[inside])):
                continue  # as quiet as rest, but moving
            found_rest = True
            yield from self._after_rest(since_s, until_s)
        if not found_rest:
            yield f"no rest of {self._settings.rest_s:g} s"

    def _after_rest(self, since_s: float, until_s: float) -> Iterator[_Found | str]:
        settings, time_s = self._settings, self._track.time_s
        rest = between(self._block, since_s, until_s)
        length_s = float(rest.dt_s.sum())
        f_b = rest.dv_b_mps.sum(axis=0) / length_s
        omega_b = rest.dtheta_b_rad.sum(axis=0) / length_s
        gyro_sigma = self._rest_sigma_radps(rest, length_s)
        tilt2 = (self._grade.accel_noise_mps_rts / np.sqrt(length_s) / 9.8) ** 2 + 1e-8

        def level(yaw_rad: float) -> FloatArray:
            return quaternion_from_euler(np.array([*_levelled(f_b), yaw_rad]))

        if settings.yaw_rad is not None:
            q_nb = level(settings.yaw_rad)
            variance = np.diag([tilt2, tilt2, self._grade.heading_rad**2])
            bias = omega_b - self._earth_rate_b(since_s, q_nb)
            still = [k for k in self._within(since_s) if time_s[k] <= until_s]
            if not still:
                yield "no GNSS fix while at rest"
                return
            yield _Found(still[-1], q_nb, variance, bias, gyro_sigma, True)
            return
        q_level = level(0.0)
        for k in self._within(until_s + 0.1):
            if time_s[k] > until_s + settings.move_off_s:
                yield f"no course within {settings.move_off_s:g} s after rest"
                return
            felt = self._reckoned(np.array([until_s, time_s[k]]), omega_b)
            if isinstance(felt, str):
                yield felt
                return
            coarse = self._moved_off(k, q_level, felt, float(time_s[k]) - until_s, gyro_sigma)
            if isinstance(coarse, str):
                yield coarse
                continue
            turn = quaternion_product(
                coarse.q_nb, quaternion_conjugate(quaternion_product(q_level, felt.q_0b[-1]))
            )
            rest_q_nb = quaternion_product(turn, q_level)
            bias = omega_b - self._earth_rate_b(since_s, rest_q_nb)
            variance = coarse.covariance_rad2 + np.diag([tilt2, tilt2, 0.0])
            yield _checked(_Found(k, coarse.q_nb, variance, bias, gyro_sigma, True))

    def _moved_off(
        self, k: int, q_level: FloatArray, felt: Reckoned, passed_s: float, gyro_sigma: float
    ) -> CoarseAttitude | str:
        """Heading from the velocity gained since rest against that of a fix."""
        v_n_mps, sigma_mps = self._track.v_n_mps[k], float(self._track.sigma_mps[k])
        gained = rotate(q_level, felt.gained_0_mps[-1]) + passed_s * self._fall(k)
        speed_mps = float(np.hypot(v_n_mps[0], v_n_mps[1]))
        # Levelling took the accelerometers' bias off; it comes back as the vehicle turns.
        gain_sigma = self._grade.accel_bias_mps2 * passed_s + 4.9 * gyro_sigma * passed_s**2
        yaw_sigma = float(np.hypot(sigma_mps, gain_sigma)) / max(speed_mps, 1e-3)
        yaw_rad = float(np.arctan2(v_n_mps[1], v_n_mps[0]) - np.arctan2(gained[1], gained[0]))
        q_first = q_level
        if yaw_sigma <= SURE_YAW_RAD:
            q_first = _turned(yaw_rad, q_level)
        here = Track(*(part[k : k + 1] for part in self._track))
        last = Reckoned(*(part[-1:] for part in felt))
        heading = heading_by_course(
            here, last, rotation_matrix(q_first), yaw_sigma, self._settings.mounting_yaw_rad
        )
        if isinstance(heading, str):
            return heading
        turn_rad, variance = heading.turn_rad, heading.variance_rad2
        if yaw_sigma <= SURE_YAW_RAD:  # both: weighted
            turn_rad *= yaw_sigma**2 / (yaw_sigma**2 + variance)
            variance = 1.0 / (1.0 / variance + 1.0 / yaw_sigma**2)
        q_nb = quaternion_product(_turned(turn_rad, q_first), felt.q_0b[-1])
        drift2 = (gyro_sigma * passed_s) ** 2
        return CoarseAttitude(q_nb, np.diag([drift2, drift2, variance]), heading.forward)

    # --- common to all ----------------------------------------------------------------------------

    def _within(self, from_s: float) -> list[int]:
        """Fixes with a velocity, from an instant on, that lie within the increments."""
        time_s, last_s = self._track.time_s, float(self._block.time_s[-1])
        inside = (time_s >= from_s) & (time_s <= last_s) & np.isfinite(self._track.sigma_mps)
        return [int(k) for k in np.flatnonzero(inside)]

    def _reckoned(self, time_s: FloatArray, gyro_bias_radps: FloatArray) -> Reckoned | str:
        piece = between(self._block, float(time_s[0]), float(time_s[-1]))
        if piece.time_s.size < 2 or piece.time_s[-1] < time_s[-1] - LONGEST_BRIDGE_S:
            return "no increments between GNSS fixes"
        missing = gaps(piece, float(time_s[0]), float(np.median(piece.dt_s)))
        if missing:
            return f"increments missing for {missing[0][1].length_s:.2f} s between GNSS fixes"
        freed = ImuBlock(
            piece.origin,
            piece.time_s,
            piece.dt_s,
            piece.dtheta_b_rad - gyro_bias_radps * piece.dt_s[:, np.newaxis],
            piece.dv_b_mps,
        )
        return reckoned(freed, time_s, self._settings.lever_b_m)

    def _fall(self, k: int) -> FloatArray:
        lat_rad, _, height_m = geodetic(self._fixes[k].r_e_m)
        return free_fall_mps2(lat_rad, height_m, self._track.v_n_mps[k])

    def _rest_sigma_radps(self, rest: ImuBlock, length_s: float) -> float:
        """1σ of the mean rate over a rest: of the grade, or of the spread found if that is more."""
        white = self._grade.gyro_noise_rad_rts / np.sqrt(length_s)
        drift = self._grade.gyro_drift_radps2_rthz * np.sqrt(length_s)
        parts = np.array_split(rest.dtheta_b_rad / rest.dt_s[:, np.newaxis], max(2, int(length_s)))
        means = np.array([part.mean(axis=0) for part in parts])
        spread = means.std(axis=0, ddof=1).max() / np.sqrt(len(parts))
        return float(max(np.hypot(white, drift), spread))

    def _earth_rate_b(self, time_s: float, q_nb: FloatArray) -> FloatArray:
        k = min(int(np.searchsorted(self._track.time_s, time_s)), len(self._fixes) - 1)
        lat_rad, _, _ = geodetic(self._fixes[k].r_e_m)
        return rotate(quaternion_conjugate(q_nb), np.array(earth_rate_n(lat_rad)))

    def _estimate(self, found: _Found) -> Estimate:
        """Estimate at a fix: the antenna led over to the unit, errors tied as they came about."""
        settings, fix = self._settings, self._fixes[found.k]
        time_s = float(self._track.time_s[found.k])
        near = between(self._block, time_s - 0.05, time_s + 0.05)
        swing_b = np.zeros(3)
        if near.dt_s.size:
            omega_b = near.dtheta_b_rad.sum(axis=0) / near.dt_s.sum() - found.gyro_bias_radps
            swing_b = np.cross(omega_b, settings.lever_b_m)
        v_n_mps = self._track.v_n_mps[found.k] - rotate(found.q_nb, swing_b)
        lat_rad, lon_rad, _ = geodetic(fix.r_e_m)
        lever_n = rotate(found.q_nb, settings.lever_b_m)
        lat_rad, lon_rad, height_m = geodetic(fix.r_e_m - C_ne(lat_rad, lon_rad).T @ lever_n)
        state = InsState(
            fix.time,
            lat_rad,
            lon_rad,
            height_m,
            v_n_mps,
            found.q_nb,
            found.gyro_bias_radps,
            *(np.zeros(3) for _ in range(3)),
        )
        return Estimate(settings.layout, state, settings.extras, self._covariance(found))

    def _covariance(self, found: _Found) -> FloatArray:
        layout, fix = self._settings.layout, self._fixes[found.k]
        P = np.zeros((layout.size, layout.size))
        inertial = slice(0, layout.inertial)
        P[inertial, inertial] = initial_covariance(
            self._grade, InitialSigmas(1.0, 1.0, 1.0, 1.0), layout.inertial, float("inf")
        )
        # Its errors last: this one fix is as good as all that count as one with it.
        P[POSITION, POSITION] = fix.covariance_n_m2 / fix.together
        P[VELOCITY, VELOCITY] = float(self._track.sigma_mps[found.k]) ** 2 * np.eye(3)
        if fix.velocity_covariance_n_m2ps2 is not None:
            P[VELOCITY, VELOCITY] = fix.velocity_covariance_n_m2ps2
        P[ATTITUDE, ATTITUDE] = found.covariance_rad2
        if found.gyro_sigma_radps is not None:
            P[GYRO_BIAS, GYRO_BIAS] = found.gyro_sigma_radps**2 * np.eye(3)
        if found.levelled:
            # Level where the force seems to be: 0 = f × φ − C_nb·δb, f = (0, 0, −g).
            to_tilt = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / 9.8
            tie = to_tilt @ rotation_matrix(found.q_nb) @ P[ACCEL_BIAS, ACCEL_BIAS]
            P[ATTITUDE, ACCEL_BIAS], P[ACCEL_BIAS, ATTITUDE] = tie, tie.T
            P[ATTITUDE, ATTITUDE] += tie @ rotation_matrix(found.q_nb).T @ to_tilt.T
        extras = np.arange(layout.inertial, layout.size)
        P[extras, extras] = self._settings.extra_sigmas**2
        return P


def _track(fixes: Sequence[GnssFix], block: ImuBlock) -> Track:
    """Velocities of fixes; where they have none, from the positions of both neighbours.

    What has no velocity either way has an infinite σ.
    """
    time_s = np.array([fix.time.since(block.origin) for fix in fixes])
    v_n, sigma = np.zeros((len(fixes), 3)), np.zeros(len(fixes))
    for k, fix in enumerate(fixes):
        sigma[k] = fix.velocity_sigma_mps
        if fix.v_n_mps is not None and fix.velocity_covariance_n_m2ps2 is not None:
            v_n[k] = fix.v_n_mps
            continue
        if not 0 < k < len(fixes) - 1:
            continue
        before, after = k - 1, k + 1
        lat_rad, lon_rad, _ = geodetic(fix.r_e_m)
        passed_s = time_s[after] - time_s[before]
        v_n[k] = C_ne(lat_rad, lon_rad) @ (fixes[after].r_e_m - fixes[before].r_e_m) / passed_s
        variance = fixes[after].covariance_n_m2 + fixes[before].covariance_n_m2
        sigma[k] = np.sqrt(np.trace(variance) / 3.0) / passed_s
    return Track(time_s, v_n, sigma)


def _rests(
    block: ImuBlock, limits: StandstillLimits, from_s: float, shortest_s: float
) -> Iterator[tuple[float, float]]:
    """Start and end of stretches at rest."""
    stood = np.concatenate([[False], standing(block, limits), [False]])
    edges = np.flatnonzero(np.diff(stood.astype(np.int8)))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        # A window stays quiet while the vehicle creeps off.
        until_s = float(block.time_s[end - 1]) - limits.window_s
        since_s = max(from_s, float(block.time_s[first]) - limits.window_s)
        if until_s - since_s >= shortest_s:
            yield since_s, until_s


def _levelled(f_b_mps2: FloatArray) -> tuple[float, float]:
    """Roll and pitch with which a specific force points up: f_b = C_bn·(0, 0, −g)."""
    f_x, f_y, f_z = f_b_mps2
    return float(np.arctan2(-f_y, -f_z)), float(np.arctan2(f_x, np.hypot(f_y, f_z)))


def _turned(yaw_rad: float, q: FloatArray) -> FloatArray:
    """Attitude turned about down."""
    turn = quaternion_from_rotation_vector(np.array([0.0, 0.0, yaw_rad]))
    return quaternion_product(turn, q)


def _checked(found: _Found) -> _Found | str:
    """An attitude, unless it is too uncertain for a filter to start from."""
    tilt_rad = float(np.sqrt(found.covariance_rad2[:2, :2].trace() / 2.0))
    yaw_rad = float(np.sqrt(found.covariance_rad2[2, 2]))
    if tilt_rad > LARGEST_TILT_RAD or yaw_rad > LARGEST_YAW_RAD:
        return (
            f"attitude found to {np.degrees(tilt_rad):.1f} deg in tilt and"
            f" {np.degrees(yaw_rad):.1f} deg in yaw only"
        )
    return found
