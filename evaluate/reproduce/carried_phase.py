"""Carrier phases through blockages, against the true ones and against what theory expects.

The satellites are really gone in the samples. The error of a phase carried through is its growth
since the last tag before, less that of the true phase at the true instants of both tags; the truth
of the receiver's clock is taken off as it is, so nothing has to be differenced. Beside it stands
the 1σ that theory.open_loop predicts from what was known when the satellite went.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
import pandas as pd

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, FloatArray, Observation, Oscillator
from deepgnss.deep.coupled import Navigated
from deepgnss.deep.navigation import Leg
from deepgnss.evaluate.reproduce.front_end import loss_db
from deepgnss.evaluate.reproduce.whole_receiver import Recording, started
from deepgnss.ins.error_model import POSITION
from deepgnss.receiver.clock import to_ns
from deepgnss.receiver.modes import Coast
from deepgnss.sim.clock import NODES_PER_SECOND, clock_error
from deepgnss.sim.delays import receive
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, Scenario
from deepgnss.theory.open_loop import (
    Growth,
    Step,
    best_fit,
    clock_growth,
    entry_growth,
    filter_growth,
    shared_growth,
    together,
)
from deepgnss.theory.tracking_error import pll_thermal_sigma_cycles, reported_share

CARRIER_HZ: Final = GPS_L1CA.carrier_hz
ORDER: Final = 3
BANDWIDTH_HZ: Final = 7.0
COHERENT_S: Final = 0.020
_RUN: Final = (
    f"tracking.carrier={{loop: pll{ORDER}, bandwidth: {BANDWIDTH_HZ}, coherent: {COHERENT_S}}}",
    "acquisition.weak=false",  # all that transmit are strong
    "output.interval=0.1",
    "deep.phase_floor=0.002",  # there are no reflections
)
_NEAR_S: Final = 0.05  # a tag this near to the edge of a blockage is not used
TAG_S: Final = 0.1
_STANDS_M: Final = 1e-3


class Hidden(NamedTuple):
    """A satellite without signal, in true time since the start."""

    satellite: str
    begin_s: float
    end_s: float


def blocked_setting(hidden: Sequence[Hidden]) -> str:
    """KEY=VALUE of a scenario that hides the satellites."""
    spans: dict[str, list[list[float]]] = {}
    for one in hidden:
        spans.setdefault(one.satellite, []).append([float(one.begin_s), float(one.end_s)])
    return f"satellites.blocked={spans}"


# --- phases at tags -------------------------------------------------------------------------------


class TrueTime:
    """When a sample was really taken, s since the start, by the clock it was counted with."""

    def __init__(self, scenario: Scenario) -> None:
        self._error = clock_error(scenario.clock, scenario.seed, scenario.vehicle)

    def __call__(self, reading_s: float) -> float:
        """True time at a reading of the clock since its reading at the start."""
        node = reading_s * NODES_PER_SECOND
        k = math.floor(node)
        before, after = (self._node(k + i) for i in (0, 1))
        return reading_s - (before + (node - k) * (after - before))

    def _node(self, k: int) -> float:
        second, rest = divmod(k, NODES_PER_SECOND)
        return float(self._error(second)[rest])


class Known(NamedTuple):
    """The navigation at a tag."""

    time_s: float  # since the start
    leg: Leg  # that led there
    P: FloatArray  # of its errors, position left out, as the phases leave it
    moves: Mapping[str, Coast]  # what it told the channels in open loop


class Phases(NamedTuple):
    """A run: carrier phases less the true ones, and the navigation beside them."""

    scenario: Scenario
    errors: pd.DataFrame
    known: list[Known]  # tag by tag, once there is a navigation


def phases(recording: Recording, *settings: str) -> Phases:
    """Carrier phase of every channel at every tag of a run, less the true phase.

    Taken after the navigation has had its say on the tag's step.

    errors: time_s (true, since the start), satellite, error_cycles (arbitrary offset per arc),
    coasting, valid, arc, half_cycle, cn0_dbhz.
    """
    scenario = recording.scenario
    true_time = TrueTime(scenario)
    rows: list[Mapping[str, object]] = []
    known: list[Known] = []
    with started(recording, *_RUN, *settings) as (_, _, engine):
        receiver = engine.receiver
        for result in engine.steps():
            known += _known(scenario, engine.navigated)
            clock = receiver.clock
            if clock is None:
                continue
            for fix in result.fixes:
                tag = fix.epoch.time
                tag_s = round(tag.since(scenario.start) * 1e9) / 1e9
                for bank in receiver.banks:
                    instant = clock.at_rate(bank.rate_hz).instant(to_ns(tag))
                    rate_hz = float(bank.rate_hz)
                    time_s = true_time(instant.sample / rate_hz + instant.fraction / rate_hz)
                    seen = bank.observe(clock, to_ns(tag), tag, output=False, smoothing=False)
                    for observations, coasting in ((seen.received, False), (seen.coasting, True)):
                        rows += [_row(tag_s, time_s, one, coasting) for one in observations]
    table = pd.DataFrame(rows)
    truth = pd.Series(0.0, table.index)
    for emitter in scenario.emitters:
        mine = table["satellite"] == emitter.satellite
        orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
        at_s = table.loc[mine, "time_s"].to_numpy()
        late_cycles = (table.loc[mine, "tag_s"] - at_s) * emitter.signal.id.carrier_hz
        true_cycles = receive(scenario, emitter, orbit, at_s).carrier_cycles
        truth[mine] = true_cycles + late_cycles
    errors = table.assign(error_cycles=table["carrier_cycles"] - truth)
    return Phases(scenario, errors.drop(columns=["tag_s", "carrier_cycles"]), known)


def _known(scenario: Scenario, navigated: Navigated) -> list[Known]:
    """The navigation at a step's last tag."""
    if not navigated.states or navigated.P is None or (leg := navigated.states[-1].leg) is None:
        return []
    time_s = navigated.states[-1].time.since(scenario.start)
    return [Known(time_s, leg, navigated.P, navigated.moves)]


def _row(tag_s: float, time_s: float, seen: Observation, coasting: bool) -> Mapping[str, object]:
    return {
        "tag_s": tag_s,
        "time_s": time_s,
        "satellite": seen.satellite,
        "carrier_cycles": seen.carrier_cycles,
        "coasting": coasting,
        "valid": seen.carrier_valid,
        "arc": seen.arc,
        "half_cycle": seen.half_cycle,
        "cn0_dbhz": seen.cn0_dbhz,
    }


# --- errors of what was carried through -----------------------------------------------------------


class Carried(NamedTuple):
    """A phase through a blockage."""

    hidden: Hidden
    time_s: FloatArray  # (n,) since the last tag before it
    error_cycles: FloatArray  # (n,) of its growth since then
    kept: bool  # valid at the end, in the arc it had before
    sigma_cycles: float  # predicted for the end, by theory
    told_cycles: float  # 1σ that the receiver itself told last

    @property
    def last_cycles(self) -> float:
        """Error at the end of the blockage; infinite where the channel had been given up."""
        length_s = self.hidden.end_s - self.hidden.begin_s
        if self.time_s.size == 0 or self.time_s[-1] < length_s - 2.0 * TAG_S:
            return math.inf
        return float(self.error_cycles[-1])


def carried(run: Phases, hidden: Sequence[Hidden]) -> list[Carried]:
    """Every blockage of a run; infinite errors where the satellite was not tracked before."""
    found = []
    groups = {str(name): rows for name, rows in run.errors.groupby("satellite")}
    for one in hidden:
        own = groups[one.satellite]
        time_s = own["time_s"]
        before = own[
            time_s.between(one.begin_s - 1.0, one.begin_s - _NEAR_S)
            & own["valid"]
            & ~own["coasting"]
        ]
        through = own[own["coasting"] & time_s.between(one.begin_s, one.end_s - _NEAR_S)]
        if before.empty or through.empty:
            found.append(Carried(one, np.empty(0), np.empty(0), False, math.nan, math.nan))
            continue
        start, end = before.iloc[-1], through.iloc[-1]
        errors = _whole(through) - start["error_cycles"]
        found.append(
            Carried(
                one,
                (through["time_s"] - start["time_s"]).to_numpy(),
                errors,
                bool(end["valid"] and end["arc"] == start["arc"]),
                float(predicted(run, one, hidden, start["cn0_dbhz"]).phase_cycles[-1]),
                _told(run, one),
            )
        )
    return found


def _whole(through: pd.DataFrame) -> FloatArray:
    """Errors in open loop; the half cycle of a polarity given up with an arc is put back."""
    errors = through["error_cycles"].to_numpy()
    steps = np.diff(errors, prepend=errors[:1])
    begun = np.diff(through["arc"].to_numpy(), prepend=through["arc"].iloc[0]) != 0
    given_up = np.where(begun, np.round(2.0 * steps) / 2.0, 0.0)
    return np.asarray(errors - np.cumsum(given_up))


def _told(run: Phases, one: Hidden) -> float:
    told = [
        known.moves[one.satellite].sigma_cycles
        for known in run.known
        if one.begin_s <= known.time_s < one.end_s and one.satellite in known.moves
    ]
    return told[-1] if told else math.nan


# --- what theory expects --------------------------------------------------------------------------


def predicted(run: Phases, one: Hidden, hidden: Sequence[Hidden], cn0_dbhz: float) -> Growth:
    """1σ at the end of a blockage, from what was known at its begin.

    cn0_dbhz: as the receiver saw it then, the other satellites' noise included.
    """
    scenario, middle_s = run.scenario, 0.5 * (one.begin_s + one.end_s)
    gone = {other.satellite for other in hidden if other.begin_s <= middle_s < other.end_s}
    sights = {
        emitter.satellite: toward_n(scenario, emitter, one.begin_s) for emitter in scenario.emitters
    }
    # of phases as they are told, each with its own symbol taken in
    thermal = pll_thermal_sigma_cycles(cn0_dbhz, BANDWIDTH_HZ, COHERENT_S) * reported_share(
        ORDER, BANDWIDTH_HZ, COHERENT_S
    )
    length_s = np.array([one.end_s - one.begin_s])
    way = _way_growth(run, one, sights[one.satellite])
    last = Growth(way.source, way.phase_cycles[-1:], way.frequency_hz[-1:])
    parts = [entry_growth(thermal, length_s)]
    others_n = np.array([toward for name, toward in sights.items() if name not in gone])
    if len(others_n):
        # Phases count as averaged for as long as navigation and clock bridge them better than they
        # are themselves.
        times_s = np.arange(1, way.phase_cycles.size + 1, dtype=np.float64) * TAG_S
        clock = _clock(scenario.clock.oscillator, len(others_n), thermal, times_s)
        bridged = together([way, clock])
        alike = max(1, int(np.sum(bridged.phase_cycles < thermal)))
        noise_cycles = thermal / math.sqrt(alike)
        parts.append(
            shared_growth(sights[one.satellite], others_n, noise_cycles, last.phase_cycles)
        )
    else:
        parts += [_clock(scenario.clock.oscillator, len(sights), thermal, length_s), last]
    return together(parts)


def toward_n(scenario: Scenario, emitter: Emitter, at_s: float) -> FloatArray:
    """Unit vector to a satellite in NED."""
    orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
    seen = receive(scenario, emitter, orbit, np.array([at_s]))
    azimuth, elevation = float(seen.azimuth_rad[0]), float(seen.elevation_rad[0])
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), -math.sin(elevation)])


def thermal_cycles(scenario: Scenario, emitter: Emitter) -> float:
    """1σ of a tracked phase behind filter and converter."""
    heard = [dbhz for _, dbhz in emitter.cn0_dbhz if math.isfinite(dbhz)]
    behind_dbhz = max(heard) - loss_db(scenario.streams[0].front_end, emitter.signal.id)
    return pll_thermal_sigma_cycles(behind_dbhz, BANDWIDTH_HZ, COHERENT_S)


def _clock(
    oscillator: Oscillator | None, satellites: int, phase_cycles: float, length_s: FloatArray
) -> Growth:
    """The clock carried on by the best fit through the mean of all phases."""
    if oscillator is None:
        return entry_growth(0.0, length_s)
    noise_cycles = phase_cycles / math.sqrt(satellites)
    fit = best_fit(oscillator, CARRIER_HZ, float(length_s[0]), noise_cycles)
    return clock_growth(oscillator, CARRIER_HZ, fit, length_s)


def _way_growth(run: Phases, one: Hidden, unit_n: FloatArray) -> Growth:
    """The navigation's way along a line of sight, uncorrected, tag by tag from its covariance."""
    through = [known for known in run.known if one.begin_s - TAG_S <= known.time_s <= one.end_s]
    ends_e_m = run.scenario.vehicle.pose(np.array([one.begin_s, one.end_s])).r_e_m
    if np.ptp(ends_e_m, axis=0).max() < _STANDS_M or len(through) < 2:  # at rest, and known to be
        still = np.zeros(round((one.end_s - one.begin_s) / TAG_S))
        return Growth("rest", still, still)
    h = unit_n / (SPEED_OF_LIGHT_MPS / CARRIER_HZ)
    steps = [
        Step(leg.end_s - leg.begin_s, leg.Phi, leg.Q, h @ leg.H_begin, h @ leg.H_end)
        for _, leg, _, _ in through[1:]
    ]
    P = np.zeros_like(through[0].leg.Phi)
    rest = slice(POSITION.stop, P.shape[0])
    P[rest, rest] = through[0].P
    return filter_growth(P, steps)
