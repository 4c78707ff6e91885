"""The long search of predicted satellites: what it finds, how exactly, how often noise passes."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

from deepgnss.core.records import RunningSums, SampleBlock, StreamInfo
from deepgnss.receiver.acquisition import Acquisition
from deepgnss.receiver.acquisition_grid import SearchWindow
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2, GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.weak_search import Aim, WeakSettings, needed_samples, weak_search

L1CA = GPS_L1CA_SIGNAL


@dataclass
class Past:
    """Samples before an instant, and what a satellite's signal is at it."""

    signal: Signal
    prn: int
    rate_hz: float
    seconds: float
    rng: np.random.Generator
    doppler_hz: float = 0.0
    code_chips: float = 0.0
    period: int = 0  # number of the code period at the instant
    rate_hzps: float = 0.0
    latest: int = 0  # sample read last

    def __post_init__(self) -> None:
        self.doppler_hz = self.rng.uniform(-4e3, 4e3)
        self.code_chips = self.rng.uniform(0.0, self.signal.id.code_chips)
        self.period = int(self.rng.integers(0, 20))
        self.now = round(self.seconds * self.rate_hz)
        noise = self.rng.standard_normal((self.now, 2), np.float32)
        self.wave = (noise * np.float32(np.sqrt(0.5))).view(np.complex64)[:, 0]

    def with_signal(self, cn0_dbhz: float, prn: int | None = None) -> Past:
        """Add a satellite, its symbols random."""
        signal, prn = self.signal, prn or self.prn
        t = (np.arange(self.now) - self.now) / self.rate_hz
        cycles = t * (self.doppler_hz + 0.5 * self.rate_hzps * t)
        length, size = signal.id.code_chips, signal.symbol_periods
        ahead = 1000 * size * length  # whole symbols, so that numbers are positive
        chips = t * signal.id.chip_rate_hz + cycles / signal.carrier_to_code + self.code_chips
        number = np.floor(chips + self.period * length + ahead).astype(np.int64)
        periods = number // length
        bits = self.rng.choice([-1.0, 1.0], 1012)
        signs = bits[periods // size] * signal.secondary[periods % size]
        signs *= signal.primary_code(prn)[number % length]
        amplitude = np.sqrt(10.0 ** (0.1 * cn0_dbhz) / self.rate_hz)
        turn = np.exp(2j * np.pi * (cycles + self.rng.random()))
        self.wave = self.wave + (amplitude * signs * turn).astype(np.complex64)
        return self

    def read(self, first: int, count: int) -> RunningSums:
        assert first >= 0
        self.latest = max(self.latest, first + count)
        stream = StreamInfo(
            "one", self.rate_hz, self.signal.id.carrier_hz, 0.0, True, self.wave.size
        )
        wave = self.wave[first : first + count]
        values = np.column_stack([wave.real, wave.imag]) * 17.0
        block = SampleBlock(stream, first, np.rint(np.clip(values, -127, 127)).astype(np.int8))
        return running_sums(block, self.signal.id.carrier_hz)

    def search(
        self,
        settings: WeakSettings,
        doppler_half_hz: float = 120.0,
        strong: tuple[Acquisition, ...] = (),
    ) -> Acquisition:
        """With a prediction that is off by something within the window."""
        off_chips = self.rng.uniform(-8.0, 8.0)
        off_hz = self.rng.uniform(-0.8, 0.8) * doppler_half_hz
        carry, chips = divmod(self.code_chips + off_chips, self.signal.id.code_chips)
        period = (self.period + int(carry)) % self.signal.symbol_periods
        window = SearchWindow(self.doppler_hz + off_hz, doppler_half_hz, chips, 10.0)
        aim = Aim(window, period, self.rate_hzps)
        return weak_search(
            self.read, self.now, self.signal, self.prn, aim, settings, self.rate_hz, strong
        )

    def chips_off(self, seen: Acquisition) -> float:
        half = 0.5 * self.signal.id.code_chips
        return (seen.code_chips - self.code_chips + half) % (2.0 * half) - half


def past(signal: Signal, length_s: float, seed: int, rate_hz: float = 2.6e6) -> Past:
    prn = 3 if signal is BDS_B1I_D2 else 19
    rate_hz = rate_hz if signal is L1CA else 5e6
    settings = WeakSettings(length_s)
    seconds = needed_samples(signal, settings, rate_hz) / rate_hz
    return Past(signal, prn, rate_hz, seconds, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("signal", "doppler_hz"), [(L1CA, 1.5), (BDS_B1I_D1, 1.5), (BDS_B1I_D2, 15.0)]
)
def test_code_phase_doppler_and_strength_now(signal: Signal, doppler_hz: float) -> None:
    """Those at the instant, not in the middle, and wherever in the window."""
    for seed in range(4):
        one = past(signal, 0.4, seed).with_signal(42.0)
        seen = one.search(WeakSettings(0.4))
        assert seen.found
        assert seen.first == one.now
        assert one.latest <= one.now  # nothing looks ahead
        assert one.chips_off(seen) == pytest.approx(0.0, abs=0.03)
        assert seen.doppler_hz == pytest.approx(one.doppler_hz, abs=doppler_hz)
        assert seen.cn0_dbhz == pytest.approx(42.0, abs=0.7)


@pytest.mark.parametrize(("signal", "trials"), [(L1CA, 8), (BDS_B1I_D1, 4)])
def test_finds_22_dbhz_in_half_a_second(signal: Signal, trials: int) -> None:
    found = 0
    for seed in range(trials):
        one = past(signal, 0.5, seed).with_signal(22.0)
        seen = one.search(WeakSettings(0.5))
        found += seen.found
        if seen.found:
            assert abs(one.chips_off(seen)) < 0.5
            assert abs(seen.doppler_hz - one.doppler_hz) < 12.0
    assert found >= trials - 1


def test_doppler_rates_are_searched_or_predicted() -> None:
    """At 2 g an unprepared search of 0.8 s sees a blur of three rows."""
    settings = WeakSettings(0.8)
    one = past(L1CA, 0.8, 3)
    one.rate_hzps = 104.0
    one.with_signal(27.0)
    predicted = one.search(settings)
    assert predicted.found
    one.rate_hzps = 0.0  # nothing known of it any more
    blurred = one.search(settings)
    assert blurred.peak_ratio < 0.7 * predicted.peak_ratio
    searched = one.search(WeakSettings(0.8, rate_hzps=110.0))
    assert searched.found
    assert searched.peak_ratio > 1.2 * blurred.peak_ratio
    assert searched.doppler_hz == pytest.approx(one.doppler_hz, abs=20.0)


@pytest.mark.parametrize("rate_hzps", [0.0, 100.0])
def test_noise_passes_as_often_as_stated(rate_hzps: float) -> None:
    settings = WeakSettings(0.1, 0.2, rate_hzps)
    found = sum(past(L1CA, 0.1, seed).search(settings).found for seed in range(40))
    assert 1 <= found <= 15  # 8 expected


def test_codes_of_strong_satellites_are_no_detections() -> None:
    """A satellite of 50 dB-Hz at the same Doppler; the searched one is not there."""
    for seed in range(4):
        one = past(L1CA, 0.2, seed).with_signal(50.0, prn=7)
        assert not one.search(WeakSettings(0.2), 20.0).found


def test_what_a_strong_code_explains_is_told() -> None:
    """Only where the Dopplers agree modulo the code's repetition rate."""
    one = past(L1CA, 0.2, 1).with_signal(30.0)
    for off_hz, explained in ((2000.0, True), (300.0, False)):
        power = 1e6  # of a code period over noise: more than any signal, so that the place is all
        doppler_hz = one.doppler_hz + off_hz
        strong = Acquisition(
            "G07", 7, one.now, doppler_hz, one.code_chips + 100.0, power, 0.0, 90.0, True
        )
        seen = one.search(WeakSettings(0.2), 20.0, (strong,))
        assert seen.found is not explained
        assert seen.reason == ("cross-correlation of G07" if explained else "")


def test_threads_change_nothing() -> None:
    one = past(L1CA, 0.3, 5).with_signal(30.0)
    aim = Aim(SearchWindow(one.doppler_hz + 40.0, 120.0, one.code_chips, 10.0), one.period)
    known = (L1CA, one.prn, aim, WeakSettings(0.3), one.rate_hz)
    alone = weak_search(one.read, one.now, *known)
    with ThreadPoolExecutor(2) as executor:
        assert weak_search(one.read, one.now, *known, executor=executor) == alone
