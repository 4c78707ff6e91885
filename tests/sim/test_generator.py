"""The samples against the truth, by a plain correlator that shares nothing with the generator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal
from demodulation import Truth, as_complex, demodulate, phase_cycles
from numpy.typing import NDArray

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.records import GPS_L1CA, ComplexArray, FloatArray, Oscillator
from deepgnss.core.time import GpsTime
from deepgnss.receiver.lnav import find_frames
from deepgnss.sim.constellation import nominal_gps
from deepgnss.sim.delays import receive
from deepgnss.sim.generator import recording, sample_source
from deepgnss.sim.motion.paths import Line, Path, Sine, Static
from deepgnss.sim.motion.profile import smooth_profile
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.scenario import Emitter, FrontEnd, ReceiverClock, Scenario, Stream
from deepgnss.sim.sky import elevations

Samples = NDArray[np.int64] | FloatArray
RATE_HZ = 4.0e6
START = GpsTime(2290, 382_256.25)
CARRIER_HZ = GPS_L1CA.carrier_hz
CLOCK = ReceiverClock(offset_s=3.0e-4, drift_sps=2.0e-7)


def _scenario(
    path: Path | None = None,
    *,
    count: int = 1,
    cn0_dbhz: float = 45.0,
    front_end: FrontEnd | None = None,
    noise: bool = False,
    clock: ReceiverClock = CLOCK,
    seconds: float = 3.0,
    seed: int = 5,
) -> Scenario:
    """The highest satellites over a place; float samples at 4 Msps unless told otherwise."""
    nav = nominal_gps(START, seconds)
    place = Vehicle(0.91, 0.18, 120.0, path or Static())
    front_end = front_end or FrontEnd(RATE_HZ, format="float32")
    seen = elevations(nav, START, place)
    highest = sorted(seen, key=lambda satellite: -seen[satellite])[:count]
    emitters = tuple(Emitter(satellite, ((0.0, cn0_dbhz),)) for satellite in highest)
    return Scenario(
        "test",
        START,
        seconds,
        place,
        emitters,
        nav,
        (Stream("L1", front_end),),
        clock=clock,
        noise=noise,
        seed=seed,
    )


# 100 g either way and 30 m/s² per millisecond of jerk on the line of sight's own scale.
HARD = Sine((0.3, -0.2, -0.933), amplitude_m=981.0 / (2.0 * np.pi * 1.6) ** 2, frequency_hz=1.6)
STEP = Line((0.6, 0.0, -0.8), smooth_profile([(0.5, 0.0), (1.5, 600.0)]))


@pytest.mark.parametrize("path", [Static(), HARD, STEP], ids=["static", "sine 100 g", "step"])
def test_carrier_follows_the_true_phase(path: Path) -> None:
    scenario = _scenario(path)
    firsts = np.arange(1, 2000, 37) * 5003  # through three seconds, on no grid of ours
    sums = demodulate(scenario, scenario.emitters[0], firsts, 400)
    assert np.abs(phase_cycles(sums)).max() < 1.0e-4
    assert np.abs(sums).min() > 0.999 * np.abs(sums).max()


@pytest.mark.parametrize(
    "front_end",
    [
        FrontEnd(16.368e6, "float32", is_complex=False, intermediate_hz=4.092e6),
        FrontEnd(2.6e6, "float32", intermediate_hz=-3.0e5),
        FrontEnd(5.0e6, "float32", centre_hz=1_575.0e6),
        FrontEnd(7_654_321.0, "float32"),
    ],
    ids=["real", "low IF", "other centre", "odd rate"],
)
def test_any_rate_and_intermediate_frequency(front_end: FrontEnd) -> None:
    scenario = _scenario(front_end=front_end)
    samples = round(front_end.sample_rate_hz * 1.0e-3)
    firsts = np.array([0, 12_345, 1_234_567])
    sums = demodulate(scenario, scenario.emitters[0], firsts, samples)
    assert np.abs(phase_cycles(sums)).max() < 1.0e-3


def test_code_lies_where_the_truth_says() -> None:
    scenario = _scenario(HARD)
    emitter = scenario.emitters[0]
    source, truth = sample_source(scenario), Truth(scenario, emitter)
    for first in (777, 4_000_001):
        cycles, sent_s = truth.between(first, 40_000)
        wiped = as_complex(source(first, 40_000)) * np.exp(-2j * np.pi * np.mod(cycles, 1.0))
        early, late = (
            np.abs(np.mean(wiped * truth.code_at(sent_s, shift))) for shift in (0.25, -0.25)
        )
        # slopes of the correlation peak: (early − late)/(early + late) = error/(1 − ¼)
        assert abs((early - late) / (early + late) * 0.75) < 0.002


def test_doppler_is_positive_while_the_range_shrinks() -> None:
    away = _scenario(Line((0.0, 0.0, 1.0), smooth_profile([(0.0, 3_000.0)])), clock=ReceiverClock())
    emitter = away.emitters[0]
    closing = replace(
        away,
        vehicle=replace(
            away.vehicle, path=Line((0.0, 0.0, -1.0), smooth_profile([(0.0, 3_000.0)]))
        ),
    )
    for scenario, sign in ((away, -1.0), (closing, 1.0)):
        truth = Truth(scenario, emitter)
        _, sent_s = truth.between(0, 4000)
        wiped = as_complex(sample_source(scenario)(0, 4000)) * truth.code_at(sent_s)
        turn = np.angle(np.sum(wiped[8:] * np.conj(wiped[:-8]))) / (2.0 * np.pi * 8 / RATE_HZ)
        assert sign * turn > 10_000.0  # 3 km/s straight down or up at the highest satellite


def test_ionosphere_parts_code_from_carrier() -> None:
    """Pseudorange and phase differ by twice the ionosphere, the code being late."""
    scenario = _scenario()
    emitter = scenario.emitters[0]
    orbit = orbit_of(scenario.orbit_set(emitter.satellite), scenario.start)
    truth = receive(scenario, emitter, orbit, np.zeros(1))
    none = receive(replace(scenario, ionosphere=False), emitter, orbit, np.zeros(1))
    wavelength_m = SPEED_OF_LIGHT_MPS / CARRIER_HZ
    delay_m = truth.ionosphere_m[0]
    assert 1.5 < delay_m < 50.0
    assert truth.pseudorange_m[0] - none.pseudorange_m[0] == pytest.approx(delay_m, abs=1e-6)
    advance_m = (truth.carrier_cycles[0] - none.carrier_cycles[0]) * wavelength_m
    assert advance_m == pytest.approx(-delay_m, abs=1e-6)


@pytest.mark.parametrize(
    ("front_end", "loss_db"),
    [
        (FrontEnd(RATE_HZ, "float32"), 0.0),
        (FrontEnd(RATE_HZ, "int8"), 0.0),
        (FrontEnd(RATE_HZ, "int16"), 0.0),
        (FrontEnd(RATE_HZ, "bits4"), 0.050),
        (FrontEnd(RATE_HZ, "int8", bits=3), 0.153),
        (FrontEnd(RATE_HZ, "bits2"), 0.543),
        (FrontEnd(RATE_HZ, "bits1"), 1.961),
        (FrontEnd(2 * RATE_HZ, "float32", is_complex=False, intermediate_hz=2.1e6), 0.0),
    ],
    ids=["float32", "int8", "int16", "4 bits", "3 bits", "2 bits", "1 bit", "real"],
)
def test_carrier_to_noise_is_what_was_set(front_end: FrontEnd, loss_db: float) -> None:
    """Less the loss of the best converter for white samples, 1 − distortion (J. Max, 1960):
    0.3634, 0.1175, 0.03454, 0.01154 for 1 to 4 bits. 0.4 s at 50 dB-Hz give 0.03 dB.
    """
    scenario = _scenario(cn0_dbhz=50.0, front_end=front_end, noise=True, seconds=0.5)
    truth = Truth(scenario, scenario.emitters[0])
    count = round(front_end.sample_rate_hz * 1.0e-3)
    first = round(truth.code_starts(0, 1)[0])
    samples = _unpacked(b"".join(recording(scenario)), front_end)[first:][: 400 * count]
    means = (samples * truth.local(first, 400 * count)).reshape(400, count).mean(axis=1)
    amplitude = abs(np.mean(means * np.sign(means.real)))
    signal = amplitude**2 * (1 if front_end.is_complex else 2)
    noise = np.mean(np.abs(samples) ** 2) - signal
    measured_dbhz = 10.0 * np.log10(amplitude**2 / noise * front_end.sample_rate_hz)
    assert measured_dbhz + loss_db == pytest.approx(50.0, abs=0.1)


def _unpacked(data: bytes, front_end: FrontEnd) -> ComplexArray:
    """Samples of a file by numpy's own means: sign bit, then magnitude, first value on top."""
    if front_end.format.startswith("bits"):
        width = int(front_end.format[4:])
        bits = np.unpackbits(np.frombuffer(data, np.uint8)).reshape(-1, width).astype(np.int64)
        magnitude = bits[:, 1:] @ (1 << np.arange(width - 2, -1, -1)) if width > 1 else 0
        flat = (1 - 2 * bits[:, 0]) * (2 * magnitude + 1)
    else:
        kinds = {"int8": np.int8, "int16": "<i2", "float32": "<f4"}
        flat = np.frombuffer(data, kinds[front_end.format])
    rows = 2 if front_end.is_complex else 1
    return as_complex(flat.reshape(-1, rows).T.astype(np.float32))


def test_steps_of_carrier_to_noise() -> None:
    scenario = _scenario()
    emitter = replace(scenario.emitters[0], cn0_dbhz=((0.0, 45.0), (0.5, 39.0), (1.0, 51.0)))
    scenario = replace(scenario, emitters=(emitter,))
    starts = Truth(scenario, emitter).code_starts(400_000, 1200)
    sums = demodulate(scenario, emitter, np.round(starts[[0, 398, 402, 1000]]), 3990)
    level_db = 20.0 * np.log10(np.abs(sums))
    assert level_db - level_db[0] == pytest.approx([0.0, 0.0, -6.0, 6.0], abs=0.02)
    assert [emitter.cn0_at(t) for t in (-1.0, 0.2, 0.5, 7.0)] == [45.0, 45.0, 39.0, 51.0]


@pytest.mark.parametrize(
    "front_end",
    [
        FrontEnd(2.6e6, "bits2"),
        FrontEnd(4.1e6, "bits1", is_complex=False, intermediate_hz=1.0e6, bandwidth_hz=1.8e6),
        FrontEnd(5.0e6, "int8", bandwidth_hz=2.5e6, filter_taps=31),
    ],
    ids=["plain", "real, filtered", "filtered"],
)
def test_same_bytes_for_any_threads_and_any_stretch(front_end: FrontEnd) -> None:
    clock = replace(CLOCK, oscillator=Oscillator("TCXO", 1.0e-21, 0.0, 2.0e-20, 0.0))
    scenario = _scenario(count=3, front_end=front_end, noise=True, clock=clock, seconds=1.2)
    whole = b"".join(recording(scenario, threads=1))
    assert len(whole) == scenario.sample_count(
        scenario.streams[0]
    ) * front_end.bytes_per_second // (front_end.sample_rate_hz)
    assert b"".join(recording(scenario, threads=3)) == whole
    source = sample_source(scenario)
    together = source(0, 300_000)
    for first, count in ((0, 1), (1, 8191), (8191, 2), (123_457, 70_001)):
        np.testing.assert_array_equal(
            sample_source(scenario)(first, count), together[:, first:][:, :count]
        )
    assert b"".join(recording(replace(scenario, seed=6))) != whole


def test_noise_is_white_and_normal() -> None:
    scenario = replace(_scenario(noise=True), emitters=())
    samples = sample_source(scenario)(0, 400_000).astype(np.float64)
    assert np.abs(samples.mean(axis=1)).max() < 5.0 / np.sqrt(400_000)
    assert samples.var(axis=1) == pytest.approx([1.0, 1.0], abs=5.0 * np.sqrt(2.0 / 400_000))
    assert np.mean(samples**4) == pytest.approx(3.0, abs=5.0 * np.sqrt(96.0 / 800_000))
    values = samples[0] + 1j * samples[1]
    for lag in (1, 2, 8192, 16384):  # the noise is drawn in blocks of 8192
        assert abs(np.mean(values[lag:] * np.conj(values[:-lag]))) < 5.0 * 2.0 / np.sqrt(380_000)
    assert abs(np.mean(samples[0] * samples[1])) < 5.0 / np.sqrt(400_000)


def test_filter_keeps_the_band_and_its_centre() -> None:
    front_end = FrontEnd(RATE_HZ, "float32", bandwidth_hz=2.0e6)
    scenario = replace(_scenario(front_end=front_end, noise=True), emitters=())
    samples = as_complex(sample_source(scenario)(0, 1 << 18))
    frequency_hz, density = scipy.signal.welch(samples, RATE_HZ, nperseg=256, detrend=False)
    density, frequency_hz = density * RATE_HZ / 2.0, np.abs(frequency_hz)  # unit noise: 1
    assert density[frequency_hz < 0.8e6] == pytest.approx(1.0, abs=0.2)
    assert density[frequency_hz < 0.8e6].mean() == pytest.approx(1.0, abs=0.01)
    assert density[frequency_hz > 1.3e6].max() < 1.0e-3
    # A symmetric filter shifts neither code nor carrier.
    signal = _scenario(front_end=front_end)
    starts = Truth(signal, signal.emitters[0]).code_starts(400_000, 5)
    sums = demodulate(signal, signal.emitters[0], np.round(starts), 4000)
    assert np.abs(phase_cycles(sums)).max() < 1.0e-3


def test_navigation_bits_leave_at_their_time() -> None:
    """Bits by the sign of the demodulated signal, 20 ms from the true start of each."""
    scenario = _scenario(seconds=13.0)
    emitter, truth = scenario.emitters[0], Truth(scenario, scenario.emitters[0])
    starts = truth.code_starts(round(0.1 * RATE_HZ), 600, every_s=0.020)
    # the first and the last whole code period of each bit, to the sample
    first, last = (
        demodulate(scenario, emitter, np.ceil(starts + offset), 3990).real
        for offset in (0, 0.019 * RATE_HZ)
    )
    assert np.abs(last / first - 1.0).max() < 0.01
    bits = (first < 0.0).astype(np.int8)
    sent_s = truth.at(starts)[1] + np.floor(START.tow_s)
    frames = find_frames(bits)
    assert len(frames) == 2
    for frame in frames:
        assert frame.polarity == 0
        assert frame.start_tow_s == pytest.approx(sent_s[frame.first], abs=1e-6)
    assert frames[0].subframe is not None
