"""Acquisition: conventions, statistics, interference, cost."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from noisy_sky import CARRIER_HZ, Sent, info, sky
from yardstick import cost

from deepgnss.core.records import BDS_B1I, SampleBlock, StreamInfo
from deepgnss.receiver import acquisition_grid
from deepgnss.receiver.acquisition import (
    Acquisition,
    AcquisitionSettings,
    SearchWindow,
    cold_search,
    cross_power,
    search,
    search_windows,
)
from deepgnss.receiver.acquisition_grid import (
    delay,
    detection_threshold,
    shift_blocks,
    sum_power,
)
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.signals import BDS_B1I_D1, b1i_code
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL as L1CA


def wrapped(chips: float) -> float:
    return (chips + 511.5) % 1023.0 - 511.5


@pytest.mark.parametrize(
    ("rate_hz", "intermediate_hz", "is_complex"),
    [(2.6e6, 0.0, True), (4.1e6, 0.0, True), (16.3e6, 120e3, True), (20.48e6, 5.5e6, False)],
)
def test_finds_code_phase_doppler_and_strength(
    rate_hz: float, intermediate_hz: float, is_complex: bool
) -> None:
    rng = np.random.default_rng(1)
    stream = info(rate_hz, is_complex, intermediate_hz)
    sent = [
        Sent(5, 3210.0, 17.3, 48.0, edge=7),
        Sent(17, -4870.0, 700.9, 45.0, edge=15),
        Sent(30, 41.0, 1022.7, 43.0),
    ]
    first = 1003  # not at the start: the code phase belongs to this sample
    sums = running_sums(sky(stream, sent, 0.0215, rng), CARRIER_HZ)
    found = {
        one.prn: one for one in cold_search(sums, first, L1CA, AcquisitionSettings()) if one.found
    }
    assert sorted(found) == [5, 17, 30]
    for one in sent:
        seen = found[one.prn]
        rate = 1.023e6 * (1.0 + one.doppler_hz / CARRIER_HZ)
        assert wrapped(seen.code_chips - one.code_chips - first / rate_hz * rate) == pytest.approx(
            0.0, abs=0.08
        )
        assert seen.doppler_hz == pytest.approx(one.doppler_hz, abs=6.0)
        assert seen.cn0_dbhz == pytest.approx(one.cn0_dbhz, abs=1.5)
        assert 0.0 <= seen.code_chips < 1023.0
        assert seen.first == first
        assert seen.satellite == f"G{one.prn:02d}"


@pytest.mark.parametrize(("coherent_s", "noncoherent"), [(0.010, 2), (0.001, 20), (0.020, 3)])
def test_pull_in_accuracy_at_40_dbhz(coherent_s: float, noncoherent: int) -> None:
    """Doppler within 15 Hz (1σ) and code within 0.1 chip, wherever the symbol edge lies."""
    rng = np.random.default_rng(2)
    stream = info(4.0e6)
    settings = AcquisitionSettings(coherent_s=coherent_s, noncoherent=noncoherent)
    doppler_hz, code_chips = [], []
    for _ in range(16):
        sent = Sent(int(rng.integers(1, 33)), rng.uniform(-5e3, 5e3), rng.uniform(0, 1023), 40.0)
        sent = Sent(*(sent.prn, sent.doppler_hz, sent.code_chips, 40.0), int(rng.integers(20)))
        block = sky(stream, [sent], coherent_s * noncoherent + 1e-4, rng)
        window = SearchWindow(sent.doppler_hz + 60.0, 200.0, sent.code_chips, 5.0)
        seen = search(running_sums(block, CARRIER_HZ), 0, L1CA, sent.prn, settings, window)
        assert seen.found
        doppler_hz.append(seen.doppler_hz - sent.doppler_hz)
        code_chips.append(wrapped(seen.code_chips - sent.code_chips))
    assert np.std(doppler_hz) < 5.0
    assert abs(np.mean(doppler_hz)) < 3.0
    assert np.std(code_chips) < 0.08
    assert abs(np.mean(code_chips)) < 0.03


def test_code_phase_is_exact_when_strong() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(10):
        sent = Sent(9, rng.uniform(-5e3, 5e3), rng.uniform(0, 1023), 55.0)
        sums = running_sums(sky(info(5.3e6), [sent], 0.0101, rng), CARRIER_HZ)
        settings = AcquisitionSettings(coherent_s=0.005, noncoherent=2)
        seen = search(sums, 0, L1CA, 9, settings)
        errors.append(wrapped(seen.code_chips - sent.code_chips))
    assert np.max(np.abs(errors)) < 0.05


@pytest.mark.parametrize("kind", ["white", "one bit, real, zero IF", "oversampled"])
@pytest.mark.parametrize(
    ("coherent_s", "noncoherent", "reach_hz"), [(0.010, 2, 1500.0), (0.001, 10, 4000.0)]
)
def test_false_alarm_rate_is_the_stated_one(
    kind: str, coherent_s: float, noncoherent: int, reach_hz: float
) -> None:
    rng = np.random.default_rng(4)
    stream = {
        "white": info(4.0e6),
        "one bit, real, zero IF": info(4.092e6, is_complex=False),
        "oversampled": info(12.0e6),
    }[kind]
    settings = AcquisitionSettings(reach_hz, 0.0, coherent_s, noncoherent, false_alarm=0.1)
    found = searched = 0
    for _ in range(5):
        block = sky(
            stream, [], coherent_s * noncoherent + 1e-4, rng, one_bit=kind.startswith("one bit")
        )
        results = cold_search(running_sums(block, CARRIER_HZ), 0, L1CA, settings)
        found += sum(one.found for one in results)
        searched += len(results)
    # 16 expected of 160; a mirrored spectrum halves the number of independent cells.
    lowest = 2 if kind.startswith("one bit") else 5
    assert lowest <= found <= 28, f"{found} of {searched}"


def test_threshold_follows_the_gamma_distribution() -> None:
    # One cell of one block: exp(−x) = false alarm.
    assert detection_threshold(1e-3, 1, 1) == pytest.approx(-math.log(1e-3))
    assert detection_threshold(1e-3, 100_000, 1) > detection_threshold(1e-3, 1000, 1)
    # The mean of many powers scatters less.
    assert detection_threshold(1e-3, 1000, 20) < detection_threshold(1e-3, 1000, 2)


def test_strong_satellites_raise_no_ghosts() -> None:
    """Cross-correlations of 60 dB-Hz signals stand 15 dB above noise; none may be reported."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        sent = [Sent(3, 1234.0, 100.0, 60.0), Sent(22, -2770.0, 512.3, 57.0, edge=4)]
        sums = running_sums(sky(info(4.0e6), sent, 0.0201, rng), CARRIER_HZ)
        results = cold_search(sums, 0, L1CA, AcquisitionSettings(false_alarm=1e-4))
        assert [one.prn for one in results if one.found] == [3, 22]


def test_weak_satellite_beside_a_strong_one_is_found() -> None:
    rng = np.random.default_rng(5)
    sent = [Sent(3, 1234.0, 100.0, 55.0), Sent(8, -1900.0, 300.0, 39.0)]
    sums = running_sums(sky(info(4.0e6), sent, 0.0201, rng), CARRIER_HZ)
    results = cold_search(sums, 0, L1CA, AcquisitionSettings())
    assert [one.prn for one in results if one.found] == [3, 8]


def test_carriers_and_dc_raise_no_ghosts() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(round(0.0201 * 4e6)) / 4e6
    carriers = 0.3 + 0.5 * np.exp(2j * np.pi * 123_000.0 * t) + 0.2 * np.exp(-2e5j * np.pi * t)
    stream = info(4.0e6)
    sent = [Sent(11, 2100.0, 44.0, 43.0)]
    sums = running_sums(sky(stream, sent, 0.0201, rng, extra=carriers), CARRIER_HZ)
    results = cold_search(sums, 0, L1CA, AcquisitionSettings(false_alarm=1e-4))
    assert [one.prn for one in results if one.found] == [11]


def test_cross_power_is_what_two_codes_show() -> None:
    """Against the sum over chips at two code phases and Dopplers a whole kHz apart."""
    from deepgnss.receiver.signals import ca_code

    strong = Acquisition("G07", 7, 0, 1000.0, 200.0, 100.0, 10.0, 50.0, True)
    weak = Acquisition("G19", 19, 0, -1000.0, 731.0, 20.0, 10.0, 30.0, True)
    chips = np.arange(1023)
    turning = np.exp(2j * np.pi * 2.0 * chips / 1023)
    product = ca_code(7)[(chips + 200) % 1023] * ca_code(19)[(chips + 731) % 1023] * turning
    expected = abs(product.mean()) ** 2
    assert cross_power(L1CA, strong, weak, 0.01) == pytest.approx(expected, rel=0.3, abs=2e-4)
    # Half a Doppler bin off a whole kHz nothing adds up.
    beside = Acquisition("G19", 19, 0, -950.0, 731.0, 20.0, 10.0, 30.0, True)
    assert cross_power(L1CA, strong, beside, 0.02) < 1e-3 * cross_power(L1CA, strong, weak, 0.02)


def test_window_limits_the_search() -> None:
    rng = np.random.default_rng(7)
    sent = Sent(14, -1500.0, 400.0, 45.0)
    sums = running_sums(sky(info(4.0e6), [sent], 0.0201, rng), CARRIER_HZ)
    settings = AcquisitionSettings()
    inside = search(sums, 0, L1CA, 14, settings, SearchWindow(-1450.0, 100.0, 395.0, 10.0))
    beside = search(sums, 0, L1CA, 14, settings, SearchWindow(-1450.0, 100.0, 300.0, 10.0))
    away = search(sums, 0, L1CA, 14, settings, SearchWindow(-700.0, 100.0, 400.0, 10.0))
    assert (inside.found, beside.found, away.found) == (True, False, False)
    assert inside.threshold < search(sums, 0, L1CA, 14, settings).threshold
    # A window over the end of the code.
    late = Sent(14, -1500.0, 1022.5, 45.0)
    sums = running_sums(sky(info(4.0e6), [late], 0.0201, rng), CARRIER_HZ)
    over = search(sums, 0, L1CA, 14, settings, SearchWindow(-1500.0, 60.0, 2.0, 6.0))
    assert over.found
    assert wrapped(over.code_chips - 1022.5) == pytest.approx(0.0, abs=0.1)


def test_threads_change_nothing() -> None:
    rng = np.random.default_rng(8)
    sums = running_sums(sky(info(4.0e6), [Sent(1, 500.0, 3.0, 45.0)], 0.0201, rng), CARRIER_HZ)
    settings = AcquisitionSettings(doppler_max_hz=1000.0)
    alone = cold_search(sums, 0, L1CA, settings)
    one = search(sums, 0, L1CA, 1, settings)
    windows = {prn: SearchWindow(400.0, 200.0, 3.0 * prn, 4.0 * prn) for prn in (2, 1)}
    apart = [search(sums, 0, L1CA, prn, settings, window) for prn, window in windows.items()]
    assert search_windows(sums, 0, L1CA, windows, settings) == apart
    assert search_windows(sums, 0, L1CA, {}, settings) == []
    with ThreadPoolExecutor(2) as executor:
        assert cold_search(sums, 0, L1CA, settings, executor=executor) == alone
        assert search(sums, 0, L1CA, 1, settings, executor=executor) == one
        assert search_windows(sums, 0, L1CA, windows, settings, executor) == apart


def test_block_end_is_enough_and_beyond_is_refused() -> None:
    rng = np.random.default_rng(9)
    block = sky(info(4.092e6), [Sent(2, 100.0, 30.0, 50.0)], 0.012, rng)
    sums = running_sums(block, CARRIER_HZ)
    whole = AcquisitionSettings(coherent_s=0.006, noncoherent=2)
    assert search(sums, 0, L1CA, 2, whole).found
    with pytest.raises(ValueError, match="exceeds the samples"):
        search(sums, 100, L1CA, 2, whole)
    with pytest.raises(ValueError, match="exceeds the samples"):
        search(sums, -1, L1CA, 2, whole)


def test_length_of_padded_windows_is_no_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    """B1I changes sign from period to period: one, three or five whole ones, all the same."""
    rng = np.random.default_rng(12)
    stream = StreamInfo("B1", 5.0e6, BDS_B1I.carrier_hz, 0.0, True, 1 << 40)
    t = np.arange(85_000) / stream.sample_rate_hz
    chips = (700.3 + t * BDS_B1I.chip_rate_hz * (1.0 - 3321.0 / BDS_B1I.carrier_hz)).astype(int)
    signs = np.array(BDS_B1I_D1.secondary)[chips // 2046]
    wave = b1i_code(30)[chips % 2046] * signs * np.exp(-2j * np.pi * 3321.0 * t)
    wave = 10.0**2.0 / np.sqrt(stream.sample_rate_hz) * wave + rng.normal(0.0, 0.5**0.5, t.size)
    wave = wave + 1j * rng.normal(0.0, 0.5**0.5, t.size)
    values = np.rint(20.0 * np.column_stack([wave.real, wave.imag])).clip(-127, 127)
    sums = running_sums(SampleBlock(stream, 0, values.astype(np.int8)), BDS_B1I.carrier_hz)
    settings = AcquisitionSettings(coherent_s=0.005, noncoherent=3)
    found = []
    for whole in (1, 3, 5):
        monkeypatch.setattr(acquisition_grid, "_WHOLE_PERIODS", (whole,))
        found.append(search(sums, 0, BDS_B1I_D1, 30, settings))
    for one in found:
        assert one.found
        assert one.doppler_hz == pytest.approx(-3321.0, abs=10.0)
        assert one.code_chips == pytest.approx(700.3, abs=0.1)
        assert one.cn0_dbhz == pytest.approx(40.0, abs=1.5)
        assert one.peak_ratio == pytest.approx(found[0].peak_ratio, rel=0.02)


def test_kernel_twin() -> None:
    rng = np.random.default_rng(10)
    values = (rng.normal(size=(3, 4, 64)) + 1j * rng.normal(size=(3, 4, 64))).astype(np.complex64)
    power, totals = np.empty((4, 64), np.float32), np.empty(4)
    sum_power(values, 1, power, totals)
    expected = (np.abs(values) ** 2).sum(axis=0)
    np.testing.assert_allclose(power, expected, rtol=1e-5)
    np.testing.assert_allclose(totals, expected.sum(axis=1), rtol=1e-5)
    power = np.empty((4, 20), np.float32)
    sum_power(values, 3, power, totals)  # of a window of 64 cells the last three times 20
    expected = (np.abs(values[:, :, 4:]) ** 2).reshape(3, 4, 3, 20).sum(axis=(0, 2))
    np.testing.assert_allclose(power, expected, rtol=1e-5)
    np.testing.assert_allclose(totals, expected.sum(axis=1), rtol=1e-5)


@pytest.mark.parametrize("cells", [256, 4096, 4095, 49_152])
@pytest.mark.parametrize("bins", [0, 7, 250])
def test_spectra_are_shifted_and_delayed(cells: int, bins: int) -> None:
    rng = np.random.default_rng(13)
    values = (rng.normal(size=(3, 2, cells)) + 1j * rng.normal(size=(3, 2, cells))).astype("c8")
    out = np.empty_like(values)
    shift_blocks(values, bins, delay(-0.7, cells), out)
    turns = np.outer([1.0, 3.0, 5.0], 0.7 * np.fft.fftfreq(cells))
    expected = np.roll(values, -bins, axis=2) * np.exp(2j * np.pi * turns)[:, np.newaxis]
    np.testing.assert_allclose(out, expected, atol=2e-5)


def test_cost() -> None:
    """In units of some 11 ms: a cold search of 32 PRNs within 1.1 s, a predicted one in 22 ms."""
    rng = np.random.default_rng(11)
    sums = running_sums(sky(info(4.0e6), [Sent(1, 500.0, 3.0, 45.0)], 0.0201, rng), CARRIER_HZ)
    settings, window = AcquisitionSettings(), SearchWindow(500.0, 100.0, 3.0, 10.0)
    search(sums, 0, L1CA, 1, settings, window)  # compiles
    assert cost(lambda: cold_search(sums, 0, L1CA, settings), 3) < 100.0
    assert cost(lambda: search(sums, 0, L1CA, 1, settings, window), 10) < 2.0
