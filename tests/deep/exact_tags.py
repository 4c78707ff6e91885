"""Tags without samples: phases of the simulator's exact ranges, legs of a navigation that errs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deepgnss.core.attitude import skew
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray, ImuGrade, NavData, Observation, Oscillator
from deepgnss.core.time import GpsTime
from deepgnss.deep.aiding import Aider, Listener, Skyline
from deepgnss.deep.bridging import Bridge, Bridged, Loop, Tag
from deepgnss.deep.navigation import Leg
from deepgnss.ins.error_model import InitialSigmas, initial_covariance, process_noise, transition
from deepgnss.ins.measurements import Measurement
from deepgnss.receiver.clock import ReceiverClock as ClockModel
from deepgnss.receiver.clock import to_ns
from deepgnss.receiver.pvt import PvtParameters
from deepgnss.receiver.signals import BDS_B1I_D1, GPS_L1CA_SIGNAL
from deepgnss.sim.clock import clock_error
from deepgnss.sim.constellation import nominal
from deepgnss.sim.delays import receive
from deepgnss.sim.motion.paths import Line, Path
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, ReceiverClock, Scenario
from deepgnss.sim.sky import elevations
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles

START = GpsTime(2290, 382_300.0)
STEP_S = 0.1
LOOP = Loop(7.0, 0.02, 0.008)
SKYLINE_TAGS = 10  # tags that share one
SIGMAS = InitialSigmas(1.0, 0.02, 5e-4, 5e-3)
Blocked = Callable[[str, float], bool]


def nobody(_satellite: str, _time_s: float) -> bool:
    return False


@dataclass(frozen=True)
class Way:
    """What motion_over asks of a trajectory."""

    vehicle: Vehicle
    origin: GpsTime
    time_s: FloatArray

    def antenna_place(self, time_s: FloatArray, _lever_b_m: FloatArray) -> FloatArray:
        return self.vehicle.point(time_s).r_m


@dataclass(frozen=True)
class Told:
    """What a bridge said at a tag, and the truth there."""

    time_s: float
    bridged: Bridged
    drift_sps: float
    phase_cycles: dict[str, float]  # true ones, with every slip put in
    off_cycles: dict[str, float]  # of phases behind a gap, as they are told
    rate_sigma_mps: FloatArray  # of the emitters, in their order


@dataclass
class Tags:
    """A drive past satellites, tag by tag.

    grade: errors of the navigation are drawn from its model; None: it is exact.
    cn0_dbhz: None: no noise of phase. slips: cycles a satellite's phase has gained from a time on,
    over a while.
    """

    seconds: float
    satellites: int = 8
    cn0_dbhz: float | None = None
    grade: ImuGrade | None = None
    oscillator: Oscillator | None = None
    path: Path | None = None
    seed: int = 1
    velocity_error_n_mps: FloatArray | None = None
    model_drift_sps: float = 2.0e-7
    drift_sps: float = 2.4e-7
    at_rest: bool = False
    step: tuple[float, float] = (np.inf, 0.0)  # when, and by how many m north, its way is off
    wheels_mps: float | None = None  # 1σ of what wheels and road say at a tag, along every axis

    @cached_property
    def scenario(self) -> Scenario:
        nav = nominal(START, self.seconds, "GC")
        path = self.path or Line((0.6, 0.8, 0.0), smooth_profile([(0.0, 15.0)]))
        vehicle = Vehicle(0.91, 0.18, 120.0, path)
        seen = elevations(nav, START, vehicle)
        ranked = sorted(seen, key=lambda satellite: -seen[satellite])
        gps = [s for s in ranked if s[0] == "G"][: self.satellites - self.satellites // 3]
        beidou = [s for s in ranked if s[0] == "C" and 5 < int(s[1:]) < 59]
        chosen = gps + beidou[: self.satellites // 3]
        emitters = tuple(
            Emitter(s, ((0.0, 45.0),), GPS_L1CA_SIGNAL if s[0] == "G" else BDS_B1I_D1)
            for s in chosen
        )
        clock = ReceiverClock(1e-6, self.drift_sps, self.oscillator)
        return Scenario(
            "tags", START, self.seconds, vehicle, emitters, nav, (), clock=clock, seed=self.seed
        )

    @property
    def nav(self) -> NavData:
        return self.scenario.nav

    @cached_property
    def times_s(self) -> FloatArray:
        return np.arange(1, round(self.seconds / STEP_S)) * STEP_S

    @cached_property
    def clock_s(self) -> FloatArray:
        """Counter less GPST at the tags."""
        source = clock_error(self.scenario.clock, self.seed)
        nodes = np.concatenate([source(k) for k in range(int(self.seconds) + 2)])
        return np.interp(self.times_s, np.arange(nodes.size) * 1e-3, nodes)

    @cached_property
    def model_s(self) -> FloatArray:
        return 1e-6 + self.model_drift_sps * self.times_s

    @cached_property
    def phases(self) -> dict[str, FloatArray]:
        """As RINEX has them, without noise."""
        offset_s = self.clock_s - self.model_s
        return {
            e.satellite: receive(
                self.scenario,
                e,
                orbit_of(self.scenario.orbit_set(e.satellite), START),
                self.times_s - offset_s,
            ).carrier_cycles
            + e.signal.id.carrier_hz * offset_s
            for e in self.scenario.emitters
        }

    def skyline(self, k: int) -> Skyline:
        """As aiding leaves it, of the tags around number k."""
        aider = Aider(PvtParameters(), np.zeros(3))
        first_s = float(self.times_s[k]) - 0.5 * STEP_S
        last_s = first_s + SKYLINE_TAGS * STEP_S
        way = Way(self.scenario.vehicle, START, np.linspace(first_s - 0.05, last_s + 0.05, 9))
        listeners = [Listener(e.satellite, e.signal.id, 4e6) for e in self.scenario.emitters]
        clock = ClockModel(4_000_000, to_ns(START))  # type: ignore[arg-type]
        span = (START.plus(first_s), START.plus(last_s))
        aider.profiles(way, span, listeners, self.nav, clock, 0.0)  # type: ignore[arg-type]
        return aider.skyline

    def run(
        self,
        bridge: Bridge,
        blocked: Blocked = nobody,
        slips: Sequence[tuple[str, float, float, float]] = (),
        clock_jump: tuple[float, float] = (np.inf, 0.0),
        corrections_n_mps: float = 0.0,
        lost: Blocked = nobody,
        upright: Sequence[str] = (),
        reflections_cycles: Mapping[str, float] = {},
        code_off_m: Callable[[str, float], float] = lambda _satellite, _time_s: 0.0,
    ) -> list[Told]:
        """Slips: satellite, cycles, when, how long it takes. A jump: when and s.

        lost: nothing is known of a satellite, and behind it a new arc begins some half cycles off
        (upright: whole ones, and it is known), or as a reflection by so many cycles more.
        """
        random = np.random.default_rng(self.seed)
        errors = _Errors(self, random)
        told = []
        phases = {s: values.copy() for s, values in self.phases.items()}
        for satellite, cycles, at_s, lasts_s in slips:
            phases[satellite] += cycles * np.clip((self.times_s - at_s) / lasts_s, 0.0, 1.0)
        for e in self.scenario.emitters:
            jumped = self.times_s > clock_jump[0]
            phases[e.satellite] += e.signal.id.carrier_hz * clock_jump[1] * jumped
        cn0 = 45.0 if self.cn0_dbhz is None else self.cn0_dbhz
        noise = 0.0 if self.cn0_dbhz is None else pll_thermal_sigma_cycles(cn0, *LOOP[:2])
        repaired = dict.fromkeys(phases, 0.0)
        arcs = dict.fromkeys(phases, 1)
        coasted = dict.fromkeys(phases, 0.0)
        away, off, open_ = set[str](), dict.fromkeys(phases, 0.0), set[str]()
        for k, t in enumerate(self.times_s):
            if k % SKYLINE_TAGS == 0:
                skyline = self.skyline(k)
            leg, P = errors.leg(k, corrections_n_mps * random.standard_normal(3))
            seen, coasting = [], []
            for e in self.scenario.emitters:
                if lost(e.satellite, t):
                    away.add(e.satellite)
                    continue
                if e.satellite in away:
                    away.remove(e.satellite)
                    arcs[e.satellite] += 1
                    half = e.satellite not in upright
                    off[e.satellite] = (0.5 if half else 1.0) * random.integers(-40, 41)
                    off[e.satellite] += reflections_cycles.get(e.satellite, 0.0)
                    open_ |= {e.satellite} if half else set()
                value = phases[e.satellite][k] + repaired[e.satellite]
                wavelength_m = SPEED_OF_LIGHT_MPS / e.signal.id.carrier_hz
                code_m = value * wavelength_m + 7.0 + code_off_m(e.satellite, t)
                value += off[e.satellite]
                if blocked(e.satellite, t):
                    # Generators on their own: off by what nobody has told them.
                    value += 0.3 + coasted[e.satellite]
                else:
                    value += noise * random.standard_normal()
                one = Observation(
                    e.satellite, e.signal.id.name, code_m, value, 0.0, cn0, 1.0,
                    False, e.satellite in open_, True, START, arcs[e.satellite],
                )  # fmt: skip
                (coasting if blocked(e.satellite, t) else seen).append(one)
            C = C_ne(0.91, 0.18)
            nothing = (np.nan, np.nan)
            tag = Tag(seen, coasting, float(self.model_s[k]), nothing, leg, P, C)
            bridged = bridge.take(tag, skyline)
            truth = {s: values[k] + repaired[s] for s, values in phases.items()}
            drift = bridge.drift_sps
            sigma_mps = bridge.rate_sigma_mps(list(phases), skyline, C)
            assert sigma_mps is not None
            drift = np.nan if drift is None else drift
            for satellite, number in bridged.halves.items():
                open_.remove(satellite)
                off[satellite] += 0.5 * (number % 2)
                arcs[satellite] += number % 2
            told.append(Told(float(t), bridged, drift, truth, off.copy(), sigma_mps))
            for satellite, move in bridged.moves.items():
                coasted[satellite] += move.cycles
            for slip in bridged.slips:
                if slip.cycles is None:
                    arcs[slip.satellite] += 1
                else:
                    repaired[slip.satellite] -= slip.cycles
        return told


class _Errors:
    """Errors of the navigation by its own model, and the legs that come of them."""

    def __init__(self, tags: Tags, random: np.random.Generator) -> None:
        self._tags, self._random = tags, random
        self._vehicle = tags.scenario.vehicle
        grade = tags.grade
        states = 15
        self.H = np.hstack([np.eye(3), np.zeros((3, 12))])
        self.x = np.zeros(states)
        self.P = np.diag(np.repeat([1.0, 1e-4, 1e-8, 1e-14, 1e-8], 3))
        if grade is None:
            self.Phi, self.Q = np.eye(states), np.diag(np.repeat([0.0, 1e-9, 0.0, 0.0, 0.0], 3))
            self.Phi[:3, 3:6] = STEP_S * np.eye(3)
        else:
            n = 20
            q = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
            dv = np.tile([0.0, 0.0, -9.81 * STEP_S / n], (n, 1))
            dt = np.full(n, STEP_S / n)
            v = np.tile([9.0, 12.0, 0.0], (n, 1))
            place = np.full(n, 0.91), np.full(n, 120.0)
            noise = process_noise(grade)
            self.Phi, self.Q = transition(*place, v, q, dt, np.zeros((n, 3)), dv, noise, states)
            self.P = initial_covariance(grade, SIGMAS, states)
            self.x = random.standard_normal(states) * np.sqrt(np.diagonal(self.P))
        if tags.velocity_error_n_mps is not None:
            self.x[3:6] = tags.velocity_error_n_mps
        self._root = np.linalg.cholesky(self.Q + 1e-24 * np.eye(states))

    def leg(self, k: int, correction_n_mps: FloatArray) -> tuple[Leg, FloatArray]:
        t = float(self._tags.times_s[k])
        r = self._vehicle.point(np.array([t - STEP_S, t])).r_m
        drawn = self._root @ self._random.standard_normal(15) if self._tags.grade else np.zeros(15)
        after = self.Phi @ self.x + drawn
        off_n_m = after[:3] - self.x[:3]
        rolled = self._rolled(after)
        off_n_m[0] += self._tags.step[1] * (t - STEP_S < self._tags.step[0] <= t)
        correction = np.zeros(15)
        if self._tags.grade is not None:  # somebody keeps it within bounds
            correction[3:] = -0.02 * after[3:]
        correction[3:6] += correction_n_mps
        self.x = after + correction
        # Much worse than what the bridge knows: it is not to start anew.
        P = self.P if k == 0 else self.P + np.diag(np.repeat([1.0, 100.0, 0.0, 0.0, 0.0], 3))
        leg = Leg(
            t - STEP_S, t, START, r[1] - r[0] + C_ne(0.91, 0.18).T @ off_n_m, np.zeros(3),
            self.H, self.H, self.Phi, self.Q, correction, self._tags.at_rest, rolled,
        )  # fmt: skip
        return leg, P

    def _rolled(self, x: FloatArray) -> tuple[Measurement, ...]:
        """Velocity along the axes of a car that heads where it drives, by its own unit."""
        sigma_mps = self._tags.wheels_mps
        if sigma_mps is None:
            return ()
        C_vn = np.array([[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
        H = np.zeros((3, x.size))
        H[:, 3:6], H[:, 6:9] = C_vn, -C_vn @ skew(np.array([9.0, 12.0, 0.0]))
        z = H @ x + sigma_mps * self._random.standard_normal(3)
        R = sigma_mps**2 * np.eye(3)
        return (
            Measurement("non-holonomic", z[1:], H[1:], R[1:, 1:]),
            Measurement("odometer", z[:1], H[:1], R[:1, :1]),
        )
