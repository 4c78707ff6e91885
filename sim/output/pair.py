"""Observations of two receivers, one behind each of a vehicle's first two antennas, on two bands.

Made at observation level, from the true ranges of each antenna at the instants its own receiver's
clock has truly reached: no loop, and no approximation of a short baseline. Either clock has an
oscillator of its own and is steered by whole milliseconds, as many receivers do. Carrier phase
grows with range.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from deepgnss.core.bands import CARRIERS_HZ
from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import (
    BDS_B1I,
    GPS_L1CA,
    Epoch,
    FloatArray,
    Observation,
    SampleInstant,
    SignalId,
)
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.sim.clock import NODES_PER_SECOND, clock_error
from deepgnss.sim.delays import place_of, receive_at
from deepgnss.sim.output.columns import instants
from deepgnss.sim.output.sight import free_cn0, in_sight, orbits_of
from deepgnss.sim.scenario import ReceiverClock, Scenario
from deepgnss.sim.seeds import random_stream

GPS_L2P: Final = SignalId("GPS_L2P", "G", "2W", CARRIERS_HZ["G"]["2"], 10.23e6, 10230)
BDS_B3I: Final = SignalId("BDS_B3I", "C", "6I", CARRIERS_HZ["C"]["6"], 10.23e6, 10230)

SECOND_BAND: Final = {GPS_L1CA.name: GPS_L2P, BDS_B1I.name: BDS_B3I}
"""What else a satellite is heard on."""

NAMES: Final = ("first.obs", "second.obs")

_STEER_S: Final = 1e-3
_MOST_CYCLES: Final = 1_000_000


class ReceiverErrors(NamedTuple):
    """Of both receivers, 1σ. Phase noise is that of a loop of `bandwidth_hz` at the C/N0."""

    code_m: float = 0.5
    bandwidth_hz: float = 15.0
    multipath_m: float = 0.003  # of a phase, and …
    multipath_s: float = 30.0  # … how long it stays
    second_clock: ReceiverClock = ReceiverClock(4.7e-4, 8e-7)  # of the second; oscillator as first


_USUAL: Final = ReceiverErrors()


def write_pair(
    folder: Path,
    scenario: Scenario,
    interval_s: float = 1.0,
    errors: ReceiverErrors = _USUAL,
) -> tuple[Path, Path]:
    """Write the RINEX files of both receivers."""
    signals = {emitter.signal.id.name: emitter.signal.id for emitter in scenario.emitters}
    second_clock = replace(errors.second_clock, oscillator=scenario.clock.oscillator)
    for k, (name, clock) in enumerate(zip(NAMES, (scenario.clock, second_clock), strict=True)):
        header = ObsHeader(
            signals=[*signals.values(), *(SECOND_BAND[one] for one in signals)],
            interval_s=interval_s,
            duration_s=scenario.seconds,
            marker=Path(name).stem.upper(),
            name=name,
        )
        with RinexObsWriter(folder, header) as file:
            for epoch in _epochs(scenario, k, clock, interval_s, errors):
                file.write(epoch)
    return folder / NAMES[0], folder / NAMES[1]


def _epochs(
    scenario: Scenario, k: int, clock: ReceiverClock, interval_s: float, errors: ReceiverErrors
) -> Iterator[Epoch]:
    """Epoch by epoch; tags are whole multiples of the interval on the steered clock."""
    tag_s = np.concatenate(list(instants(scenario.start, scenario.seconds, interval_s)))
    late_s = _steered(scenario, k, clock, tag_s)
    place = place_of(scenario, tag_s - late_s, k)
    rows = []
    for emitter, orbit in zip(scenario.emitters, orbits_of(scenario), strict=True):
        seen = in_sight(scenario, emitter, orbit, place)
        cn0_dbhz = free_cn0(emitter, place.t_s)
        for signal in (emitter.signal.id, SECOND_BAND[emitter.signal.id.name]):
            heard = replace(emitter, signal=_Carrier(signal))  # type: ignore[arg-type]
            truth = receive_at(scenario, heard, orbit, place)
            noise = random_stream(scenario.seed, f"pair {k} {emitter.satellite} {signal.name}")
            code, cycles, ambiguity = _errors(noise, cn0_dbhz, seen, signal, interval_s, errors)
            range_m = truth.pseudorange_m + SPEED_OF_LIGHT_MPS * late_s + code
            carrier = truth.carrier_cycles + signal.carrier_hz * late_s + cycles + ambiguity
            rows.append((emitter, signal, seen, range_m, carrier, cn0_dbhz))
    for n, tag in enumerate(tag_s):
        time = scenario.start.plus(float(tag))
        observations = tuple(
            Observation(
                satellite=emitter.satellite,
                signal=signal.name,
                pseudorange_m=float(range_m[n]),
                carrier_cycles=float(carrier[n]),
                doppler_hz=math.nan,
                cn0_dbhz=float(cn0_dbhz[n]),
                lock_time_s=0.0,
                slip=bool(n == 0 or not seen[n - 1]),
                half_cycle=False,
                carrier_valid=True,
                transmit=time.plus(-float(range_m[n]) / SPEED_OF_LIGHT_MPS),
            )
            for emitter, signal, seen, range_m, carrier, cn0_dbhz in rows
            if seen[n]
        )
        yield Epoch(time, SampleInstant(0, 0.0), observations)


class _Carrier(NamedTuple):
    """As much of a signal as a delay depends on."""

    id: SignalId


def _steered(scenario: Scenario, k: int, clock: ReceiverClock, tag_s: FloatArray) -> FloatArray:
    """Clock reading less GPST at the tags, whole milliseconds taken off, s."""
    vehicle = scenario.vehicle if k == 0 else None
    error = clock_error(clock, scenario.seed + 7919 * k, vehicle)
    node = np.round(tag_s * NODES_PER_SECOND).astype(np.int64)
    seconds = {int(number): error(int(number)) for number in np.unique(node // NODES_PER_SECOND)}
    raw_s = np.array([seconds[n // NODES_PER_SECOND][n % NODES_PER_SECOND] for n in node.tolist()])
    return np.asarray(raw_s - _STEER_S * np.round(raw_s / _STEER_S))


def _errors(
    noise: np.random.Generator,
    cn0_dbhz: FloatArray,
    seen: NDArray[np.bool_],
    signal: SignalId,
    interval_s: float,
    errors: ReceiverErrors,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Error of code, m, and phase, cycles, and whole cycles of each arc, (n,) each."""
    size = cn0_dbhz.size
    code, white, drive = noise.standard_normal((3, size))
    strength = 10.0 ** (np.where(np.isfinite(cn0_dbhz), cn0_dbhz, 40.0) / 10.0)
    thermal = np.sqrt(errors.bandwidth_hz / strength) / (2.0 * np.pi)
    kept = math.exp(-interval_s / errors.multipath_s)
    drive[1:] *= math.sqrt(1.0 - kept * kept)
    slow_m = errors.multipath_m * lfilter([1.0], [1.0, -kept], drive)
    starts = np.diff(seen.astype(np.int64), prepend=0) > 0
    ambiguities = noise.integers(-_MOST_CYCLES, _MOST_CYCLES, int(starts.sum()) + 1)
    phase = thermal * white + slow_m * signal.carrier_hz / SPEED_OF_LIGHT_MPS
    return errors.code_m * code, phase, ambiguities[np.cumsum(starts)].astype(np.float64)
