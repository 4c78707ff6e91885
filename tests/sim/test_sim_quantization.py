"""Loss of the converter: known figures, and what a correlator measures before and behind it."""

from __future__ import annotations

import numpy as np
import pytest
from demodulation import Truth, as_complex

from deepgnss.core.records import ComplexArray
from deepgnss.core.time import GpsTime
from deepgnss.io.formats import VALUE_BITS
from deepgnss.sim.constellation import nominal_gps
from deepgnss.sim.converter import convert
from deepgnss.sim.generator import input_sigma, sample_source
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.quantization import quantization_loss_db
from deepgnss.sim.scenario import Emitter, FrontEnd, Scenario, Stream
from deepgnss.sim.sky import elevations

START = GpsTime(2290, 382_256.25)
CN0_DBHZ = 46.0


@pytest.mark.parametrize(
    ("bits", "distortion"),
    [
        (1, 0.3634),
        (2, 0.1188),
        (3, 0.03744),
        (4, 0.01154),
        (5, (9 / 32) ** 2 / 12),
        (6, (9 / 64) ** 2 / 12),
    ],
)
def test_white_noise_loses_what_max_found(bits: int, distortion: float) -> None:
    """Mean squared error of the best uniform quantizer (J. Max, 1960, table II) up to 4 bits.

    Finer ones leave headroom and lose Δ²/12, Δ = 9 σ/2ᵇ.
    """
    loss_db = quantization_loss_db(FrontEnd(4.0e6, "int8", bits))
    assert loss_db == pytest.approx(-10.0 * np.log10(1.0 - distortion), abs=0.003)


def test_fine_converters_lose_nothing_and_filters_help() -> None:
    assert quantization_loss_db(FrontEnd(4.0e6, "float32")) == 0.0
    assert quantization_loss_db(FrontEnd(4.0e6, "int8")) < 1.0e-3
    assert 0.0 < quantization_loss_db(FrontEnd(4.0e6, "int16")) < 1.0e-5
    white, coloured = (
        quantization_loss_db(FrontEnd(8.0e6, "bits1", bandwidth_hz=bandwidth_hz))
        for bandwidth_hz in (None, 2.2e6)
    )
    assert coloured < white - 0.4


def _one_satellite(front_end: FrontEnd, seconds: float) -> Scenario:
    vehicle, nav = Vehicle(0.91, 0.18, 120.0), nominal_gps(START, seconds)
    seen = elevations(nav, START, vehicle)
    satellite = max(seen, key=lambda name: seen[name])
    emitter = Emitter(satellite, ((0.0, CN0_DBHZ),))
    return Scenario("one", START, seconds, vehicle, (emitter,), nav, (Stream("L1", front_end),))


def _read(data: bytes, front_end: FrontEnd) -> ComplexArray:
    rows = 1 + front_end.is_complex
    if VALUE_BITS[front_end.format] == 8:
        return as_complex(np.frombuffer(data, np.int8).reshape(-1, rows).T.astype(np.float32))
    bits = np.unpackbits(np.frombuffer(data, np.uint8)).reshape(-1, VALUE_BITS[front_end.format])
    magnitude = bits[:, 1:].astype(int) @ (1 << np.arange(bits.shape[1] - 2, -1, -1))
    flat = (1 - 2 * bits[:, 0].astype(int)) * (2 * magnitude + 1)
    return as_complex(flat.reshape(-1, rows).T.astype(np.float32))


def _measured(front_end: FrontEnd, seconds: float) -> tuple[float, float]:
    """C/N0 by a correlator, dB-Hz, before and behind the converter.

    Signal: mean over the milliseconds, data bits by their sign. Noise: what codes of 16 satellites
    that are not there bring out of the same samples.
    """
    scenario = _one_satellite(front_end, seconds)
    emitter = scenario.emitters[0]
    truth, source = Truth(scenario, emitter), sample_source(scenario)
    period = round(front_end.sample_rate_hz * 1.0e-3)
    first = int(np.ceil(truth.code_starts(8000, 1)[0])) // 8 * 8
    others = np.where(np.random.default_rng(4).random((16, 1023)) < 0.5, -1, 1)
    signals: list[list[complex]] = [[], []]
    noises: list[list[float]] = [[], []]
    sigma = input_sigma(scenario, front_end)
    count = 50 * period
    for begin in range(first, first + int((seconds - 0.1) / 0.05) * count, count):
        samples = source(begin, count)
        cycles, sent_s = truth.between(begin, count)
        turn = np.exp(-2j * np.pi * np.mod(cycles, 1.0))
        chips = np.floor(sent_s * 1.023e6).astype(int) % 1023
        local = truth.code_at(sent_s)
        before = as_complex(samples)
        behind = _read(convert(samples, sigma, front_end), front_end)
        for k, values in enumerate((before, behind)):
            wiped = (values * turn).astype(np.complex64)
            signals[k] += list((wiped * local).reshape(-1, period).sum(axis=1))
            for code in others:
                noise = (wiped * code[chips]).reshape(-1, period).sum(axis=1)
                noises[k].append(float(np.mean(np.abs(noise) ** 2)))
    out = []
    for k in (0, 1):
        sums = np.array(signals[k])
        amplitude = np.abs(np.mean(sums * np.sign(sums.real)))
        out.append(10.0 * np.log10(amplitude**2 / np.mean(noises[k]) * 1000.0))
    return out[0], out[1]


def _check(front_end: FrontEnd, seconds: float, limit_db: float) -> None:
    before_dbhz, behind_dbhz = _measured(front_end, seconds)
    loss_db = quantization_loss_db(front_end)
    # random codes on this one, chip on chip: its power over the chip rate
    own_db = 10.0 * np.log10(1.0 + 10.0 ** (CN0_DBHZ / 10.0) / 1.023e6)
    assert before_dbhz - behind_dbhz == pytest.approx(loss_db, abs=limit_db)
    if front_end.bandwidth_hz is None:
        assert behind_dbhz + loss_db + own_db == pytest.approx(CN0_DBHZ, abs=limit_db)


QUICK = [
    FrontEnd(4.0e6, "bits1"),
    FrontEnd(4.0e6, "bits2"),
    FrontEnd(4.0e6, "bits1", bandwidth_hz=2.0e6),
]
LONG = [
    FrontEnd(4.0e6, "int8", 3),
    FrontEnd(4.0e6, "bits4"),
    FrontEnd(4.0e6, "int8"),
    FrontEnd(8.0e6, "bits2", bandwidth_hz=2.2e6),
    FrontEnd(8.0e6, "bits1", is_complex=False, intermediate_hz=2.0e6, bandwidth_hz=3.0e6),
]


@pytest.mark.parametrize("front_end", QUICK, ids=["1 bit", "2 bits", "1 bit, filtered"])
def test_loss_is_the_one_measured(front_end: FrontEnd) -> None:
    _check(front_end, 0.45, 0.25)


@pytest.mark.slow
@pytest.mark.parametrize("front_end", [*QUICK, *LONG])
def test_carrier_to_noise_is_the_one_set_to_a_tenth(front_end: FrontEnd) -> None:
    _check(front_end, 4.0, 0.1)
