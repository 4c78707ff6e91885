"""Levels and guesses on samples whose faults are known because they were made here."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deepgnss.core.records import SampleBlock, StreamInfo
from deepgnss.evaluate.inspection import (
    Inspection,
    inspect,
    measure_levels,
    measure_spectrum,
    passband,
)
from deepgnss.evaluate.inspection_figures import (
    draw_inspection,
    folded_histogram,
    histogram_text,
    spectrum_text,
)

RATE = 4.0e6
L1 = 1575.42e6


def block(samples: np.ndarray, intermediate_hz: float = 0.0, first: int = 0) -> SampleBlock:
    info = StreamInfo("L1", RATE, L1, intermediate_hz, samples.ndim == 2, 10_000_000)
    return SampleBlock(info, first, samples)


def noise(n: int = 100_000, sigma: float = 20.0, width: int = 2, kind: str = "i1") -> np.ndarray:
    rng = np.random.default_rng(5)
    return np.clip(rng.normal(0, sigma, (n, width)).round(), -127, 127).astype(kind)


def words(seen: Inspection) -> str:
    return " | ".join(seen.findings)


def test_good_noise_has_no_findings() -> None:
    assert inspect(block(noise()), 128).findings == ()
    assert inspect(block(noise(width=1)[:, 0]), 128).findings == ()
    assert inspect(block(noise(sigma=900.0, kind="i2")), 32768).findings == ()
    signs = np.where(noise() < 0, -1, 1).astype(np.int8)
    assert inspect(block(signs), 1).findings == ()
    coarse = (signs * np.where(np.abs(noise()) > 20, 3, 1)).astype(np.int8)
    assert inspect(block(coarse), 3).findings == ()
    assert inspect(block(coarse), 128).findings == ()  # ±1, ±3 in bytes


def test_levels_by_hand() -> None:
    samples = np.array([[3, 0], [3, 4], [3, 0], [3, -4]], np.int8)
    levels = measure_levels(block(samples, first=70), 4)
    assert levels.rms == pytest.approx(math.sqrt((9 * 4 + 32) / 8))
    assert levels.dbfs == pytest.approx(20 * math.log10(levels.rms / 4))
    assert levels.dc == 3 + 0j
    assert levels.saturated_share == 2 / 8
    assert levels.zero_share == 2 / 8
    assert (levels.longest_run, levels.longest_run_at) == (1, 70)


@settings(deadline=None, derandomize=True, max_examples=20)
@given(gain_db=st.floats(-3, 3), phase_deg=st.floats(-20, 20))
def test_imbalance_is_measured_with_its_sign(gain_db: float, phase_deg: float) -> None:
    x, y = noise(40_000, 3000.0, 2, "i2").astype(float).T * 30
    phase = math.radians(phase_deg)
    i = x * 10 ** (gain_db / 20)
    q = y * math.cos(phase) + x * math.sin(phase)
    levels = measure_levels(block(np.column_stack([i, q]).round().astype(np.int16)), 32768)
    assert levels.gain_imbalance_db == pytest.approx(gain_db, abs=0.15)
    assert math.degrees(levels.quadrature_error_rad) == pytest.approx(phase_deg, abs=1.0)


def test_spectrum_density_integrates_to_power() -> None:
    for samples in (noise(), noise(width=1)[:, 0]):
        spectrum = measure_spectrum(block(samples))
        step_hz = spectrum.frequency_hz[1] - spectrum.frequency_hz[0]
        power = np.sum(10 ** (spectrum.density_db / 10)) * step_hz
        assert power == pytest.approx(20.0**2 * (1 if samples.ndim == 1 else 2), rel=0.03)
        assert np.all(np.diff(spectrum.frequency_hz) > 0)


def test_tone_stands_at_its_signed_frequency() -> None:
    n = np.arange(100_000)
    tone = 100 * np.exp(-2j * np.pi * 0.7e6 / RATE * n)
    samples = np.column_stack([tone.real, tone.imag]).round().astype(np.int8)
    spectrum = measure_spectrum(block(samples))
    peak_hz = spectrum.frequency_hz[np.argmax(spectrum.density_db)]
    assert peak_hz == pytest.approx(-0.7e6, abs=RATE / 512)
    mixed = np.clip(samples * 0.3 + noise(), -127, 127).astype(np.int8)
    assert "a line" in words(inspect(block(mixed), 128))


@pytest.mark.parametrize(
    ("samples", "full_scale", "word"),
    [
        (np.zeros((5000, 2), np.int8), 128, "all samples are zero"),
        (np.full(5000, 7, np.int8), 128, "all are 7"),
        (noise(sigma=150.0), 127, "at full scale"),
        (noise() + np.int8(30), 128, "DC offset"),
        (noise() * np.array([2, 1], np.int8), 128, "+6.0 dB against Q"),
        (noise() * np.array([1, 0], np.int8), 128, "Q is always 0"),
        (noise()[:, [0, 0]], 128, "real samples described as iq"),
        (np.concatenate([noise(), np.zeros((400, 2), np.int8), noise()]), 128,
         "400 equal samples in a row at sample 100000"),
        (np.where(np.abs(noise(sigma=1.0)) < 3, 0, 1).astype(np.int8), 128, "gain too low"),
        (noise(kind="i1", sigma=15.0).view(np.int16).reshape(-1, 1)[:, 0], 32768,
         "8-bit samples read as int16"),
        (noise(kind="i2", sigma=120.0, n=50_000).view(np.int8).reshape(-1, 2), 128,
         "int16 read as int8"),
        (np.random.default_rng(8).normal(size=50_000).astype("<f4").view(np.int8).reshape(-1, 2),
         128, "float32 read as int8"),
        (np.packbits(noise() < 0).view(np.int8).reshape(-1, 2), 128, "packed 1-bit samples"),
        (np.packbits((noise()[:, [0, 0]] < 0) & (noise(width=2) < 5)).view(np.int8).reshape(-1, 2),
         128, "packed"),
        (1 - 2 * np.unpackbits(noise(n=8000, sigma=2.0).view(np.uint8)).astype(np.int8), 1,
         "place in the byte"),
    ],
)  # fmt: skip
def test_faults_are_named(samples: np.ndarray, full_scale: int, word: str) -> None:
    assert word in words(inspect(block(samples), full_scale))


def band_noise(centre_hz: float) -> np.ndarray:
    rng = np.random.default_rng(9)
    n = 1 << 17
    frequency_hz = np.fft.fftfreq(n, 1 / RATE)
    shape = np.where(np.abs(frequency_hz - centre_hz) < 0.4e6, 1.0, 0.1)
    z = np.fft.ifft(np.fft.fft(rng.normal(size=n) + 1j * rng.normal(size=n)) * shape)
    z *= 25 / np.std(z)
    return np.column_stack([z.real, z.imag]).round().astype(np.int8)


def test_passband_and_if_sign() -> None:
    samples = band_noise(1.0e6)
    edges = passband(measure_spectrum(block(samples)))
    assert edges is not None
    assert edges[0] == pytest.approx(0.6e6, abs=0.08e6)
    assert edges[1] == pytest.approx(1.4e6, abs=0.08e6)
    assert inspect(block(samples, 1.0e6), 128).findings == ()
    assert "wrong sign" in words(inspect(block(samples, -1.0e6), 128))
    assert "does not hold" in words(inspect(block(samples, 0.0), 128))
    assert passband(measure_spectrum(block(noise()))) is None


def test_few_samples_are_no_obstacle() -> None:
    for count in (1, 2, 5, 50):
        seen = inspect(block(noise()[:count]), 128)
        assert seen.counts.sum() == 2 * count
        assert spectrum_text(seen)


def test_text_pictures() -> None:
    n = np.arange(100_000)
    tone = 100 * np.exp(2j * np.pi * 1e6 / RATE * n)
    seen = inspect(block(np.column_stack([tone.real, tone.imag]).round().astype(np.int8)), 128)
    rows = spectrum_text(seen, width=64, height=4)
    assert len(rows) == 6
    plot = [row.partition("│")[2] for row in rows[:4]]
    assert {len(row) for row in plot} == {64}
    assert max(range(64), key=lambda k: sum(row[k] == "█" for row in plot)) in (47, 48)
    lines = histogram_text(inspect(block(np.array([-1, 1, 1, 1], np.int8)), 1))
    assert [line.split()[:2] for line in lines] == [["-1", "25.00"], ["1", "75.00"]]
    assert lines[1].count("█") == 3 * lines[0].count("█") + 1  # 40 against 13


def test_histogram_classes_hold_whole_values() -> None:
    value, share = folded_histogram(inspect(block(noise()), 128), 17)
    assert value.size <= 17
    assert share.sum() == pytest.approx(1.0)
    assert np.ptp(np.diff(value)) == pytest.approx(0.0)
    assert np.sum(value * share) == pytest.approx(noise().mean(), abs=2.0)


def test_figure(tmp_path: Path) -> None:
    path = tmp_path / "new" / "look.png"
    seen = [inspect(block(band_noise(0.5e6), 0.5e6), 128), inspect(block(noise()), 128)]
    draw_inspection(path, seen)
    once = path.read_bytes()
    assert once.startswith(b"\x89PNG")
    draw_inspection(path, seen)
    assert path.read_bytes() == once
