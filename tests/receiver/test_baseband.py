"""The correlator against one that goes sample by sample; the running sum bit by bit."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sampled_code import (
    CARRIER_HZ,
    CHIP_HZ,
    brute_force,
    carrier_cycles,
    code_chips,
    sampled,
    signal_command,
    stream,
)

from deepgnss.core.records import PackedSamples, RunningSums, SampleBlock, StreamInfo
from deepgnss.receiver.baseband import (
    RunningSumBuffer,
    correlate,
    resample,
    running_sums,
    sum_stretch,
)
from deepgnss.receiver.signals import ca_code, code_runs

pytestmark = pytest.mark.kernel
PRN = 11
RUNS = code_runs("GPS_L1CA", PRN)
TAPS = np.array([0.5, 0.125, 0.0, -0.125, -0.5, 0.05, -0.9])
LIMIT_DEG = {0.0: 0.2, 0.05: 0.2, 0.125: 0.25, 0.5: 1.0}

# name → stream: every kind of front end the files have.
STREAMS = {
    "2.6 complex": stream(2.6e6),
    "4 complex IF": stream(4.0e6, intermediate_hz=0.42e6),
    "4 complex, centre elsewhere": stream(4.0e6, centre_hz=CARRIER_HZ + 3.1e5),
    "4 complex, IF from inversion": stream(4.0e6, intermediate_hz=-0.6e6),
    "5.115 complex": stream(5.115e6),
    "12 real": stream(12.0e6, is_complex=False, intermediate_hz=3.0e6),
    "16 complex": stream(16.0e6),
    "16.368 real": stream(16.368e6, is_complex=False, intermediate_hz=4.092e6),
    "20.48 real, IF from inversion": stream(20.48e6, is_complex=False, intermediate_hz=-5.5e6),
    "25 complex": stream(25.0e6),
    "62 complex": stream(62.0e6),
}


def _loss_and_phase(seen: complex, wanted: complex) -> tuple[float, float]:
    """Loss in dB and phase in degrees against the brute-force sum."""
    ratio = seen / wanted
    return -20.0 * float(np.log10(abs(ratio))), float(np.degrees(np.angle(ratio)))


# --- correlations --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize("doppler_hz", [6000.0, -6000.0])
def test_loss_and_phase_against_brute_force(name: str, doppler_hz: float) -> None:
    """SPEC 4: loss ≤ 0.01 dB, phase ≤ 0.2°.

    Taps share the phasors of the prompt's runs. Half a chip off that turns the correlation by
    0.55° at 6 kHz, early and late against each other, which envelopes do not see.
    """
    info = STREAMS[name]
    truth = signal_command(9, doppler_hz=doppler_hz, code_chips=-0.37, carrier_cycles=0.21)
    count = int(1.02e-3 * info.sample_rate_hz)
    block = sampled(info, PRN, truth, 0, count)
    seen = correlate(running_sums(block, CARRIER_HZ), truth, RUNS, TAPS, 1)[0]
    wanted = brute_force(block, PRN, truth, TAPS, 1)[0]
    for tap in range(TAPS.size - 1):
        loss_db, phase_deg = _loss_and_phase(seen[tap], wanted[tap])
        assert -0.02 < loss_db < 0.01, TAPS[tap]  # the mixing table's rounding is a gain
        assert abs(phase_deg) < LIMIT_DEG[abs(TAPS[tap])], TAPS[tap]
    prompt = 100.0 * 1e-3 * info.sample_rate_hz / (1 if info.is_complex else 2)
    assert abs(seen[2]) == pytest.approx(prompt, rel=0.01)
    assert np.angle(seen[2]) == pytest.approx(0.0, abs=0.01)  # the command is the truth
    # Nine tenths of a chip off little is left: compare with the whole.
    assert abs(seen[-1] - wanted[-1]) < 0.02 * abs(wanted[2])


@pytest.mark.parametrize("doppler_hz", [5500.0, -5500.0])
def test_wide_samples_mixed_from_an_intermediate_frequency(doppler_hz: float) -> None:
    """int16 leaves the mixing table few levels; the loss stays as small."""
    info = stream(4.0e6, intermediate_hz=1.0e6)
    truth = signal_command(20, doppler_hz=doppler_hz, code_chips=-4.2, carrier_cycles=0.4)
    block = sampled(info, PRN, truth, 0, 4100, amplitude=8000.0)
    assert block.samples.dtype == np.int16
    seen = correlate(running_sums(block, CARRIER_HZ), truth, RUNS, TAPS[2:3], 1)[0, 0]
    wanted = brute_force(block, PRN, truth, TAPS[2:3], 1)[0, 0]
    loss_db, phase_deg = _loss_and_phase(seen, wanted)
    assert abs(loss_db) < 0.01
    assert abs(phase_deg) < 0.2


@pytest.mark.parametrize("doppler_hzps", [0.0, 100.0, 290.0, 5000.0, -5000.0])
def test_a_command_carries_its_frequency_rate_through_all_periods(doppler_hzps: float) -> None:
    """Twenty periods of up to 100 g under one command: every one as by brute force.

    Neighbours share the phasors of their runs, whichever of them are asked for together.
    """
    info = stream(2.6e6)
    truth = signal_command(
        5, doppler_hz=2500.0, code_chips=-1.0, carrier_cycles=3.3, doppler_hzps=doppler_hzps
    )
    block = sampled(info, PRN, truth, 0, 53_000)
    taps = np.array([0.25, 0.0, -0.25])
    seen = correlate(running_sums(block, CARRIER_HZ), truth, RUNS, taps, 20)
    wanted = brute_force(block, PRN, truth, taps, 20)
    assert seen.shape == (20, 3)
    for period in range(20):
        for tap in range(3):
            loss_db, phase_deg = _loss_and_phase(seen[period, tap], wanted[period, tap])
            assert abs(loss_db) < 0.01
            assert abs(phase_deg) < 0.2
    sums = running_sums(block, CARRIER_HZ)
    pieces = [correlate(sums, truth, RUNS, taps, 3, skip=3 * k) for k in range(6)]
    assert np.array_equal(np.concatenate(pieces), seen[:18])


def test_phase_and_delay_of_a_period_are_those_of_its_command() -> None:
    """A replica ahead by 0.1 cycle sees −0.1; one whose code lags sees the early tap grow."""
    info = stream(16.0e6)
    truth = signal_command(9, doppler_hz=900.0, code_chips=-0.3)
    sums = running_sums(sampled(info, PRN, truth, 0, 16_400), CARRIER_HZ)
    ahead = correlate(sums, truth._replace(carrier_cycles=0.1), RUNS, np.zeros(1), 1)[0, 0]
    assert np.angle(ahead) / (2.0 * np.pi) == pytest.approx(-0.1, abs=1e-4)
    lagging = truth._replace(code_chips=truth.code_chips - 0.2)
    early, prompt, late = abs(correlate(sums, lagging, RUNS, np.array([0.2, 0.0, -0.2]), 1)[0])
    assert early > prompt > late


@pytest.mark.parametrize("rate_hz", [2.6e6, 5.115e6])
def test_code_phase_comes_back_without_bias(rate_hz: float) -> None:
    """Half-sample convention: the balance of early and late is at the true code phase."""
    info, taps = stream(rate_hz), np.array([0.25, -0.25])
    errors = []
    for late in (np.arange(16) + 0.5) / 16 * CHIP_HZ / rate_hz:
        truth = signal_command(9, doppler_hz=0.0, code_chips=-late)
        sums = running_sums(sampled(info, PRN, truth, 0, int(1.02e-3 * rate_hz)), CARRIER_HZ)
        early, minus = abs(correlate(sums, truth, RUNS, taps, 1)[0])
        errors.append((early - minus) / (early + minus) * 0.75)
    assert abs(np.mean(errors)) < 0.001


# --- the running sum -----------------------------------------------------------------------------


def _noise(info: StreamInfo, first: int, count: int, dtype: type = np.int8) -> SampleBlock:
    limits = np.iinfo(dtype)
    shape = (count, 2) if info.is_complex else (count,)
    generator = np.random.default_rng([first, count])
    values = generator.integers(limits.min, limits.max, shape, endpoint=True)
    return SampleBlock(info, first, values.astype(dtype))


def _unpacked(sums: RunningSums, first: int, last: int) -> tuple[int, int]:
    """I and Q between two entries, by Python's unlimited integers."""
    value = (int(sums.packed[last]) - int(sums.packed[first]) + 2**63) % 2**64 - 2**63
    q = (value + 2**31) % 2**32 - 2**31
    return (value - q) >> 32, q


@pytest.mark.parametrize("dtype", [np.int8, np.int16])
def test_sums_are_exact(dtype: type) -> None:
    block = _noise(stream(4.0e6), 0, 4000, dtype)
    sums = running_sums(block, CARRIER_HZ)
    assert sums.packed.size == 4001
    for first, last in [(0, 4000), (17, 18), (1000, 3999)]:
        wanted = block.samples[first:last].astype(np.int64).sum(axis=0)
        assert _unpacked(sums, first, last) == (int(wanted[0]), int(wanted[1]))


def test_differences_survive_wrap_around() -> None:
    """Totals about to leave their 32 bits change nothing."""
    block = _noise(stream(4.0e6), 0, 4200)
    plain = RunningSumBuffer(block.stream, CARRIER_HZ, 4201)
    plain.append(block)
    for i_total, q_total in [(2**31 - 5, 0), (-(2**31) + 5, 2**31 - 7), (0, -(2**31) + 3)]:
        wrapped = RunningSumBuffer(block.stream, CARRIER_HZ, 4201)
        wrapped._total = (i_total << 32) + q_total
        wrapped._packed[0] = wrapped._total
        wrapped.append(block)
        for first, last in [(0, 4200), (1, 2), (1500, 2999)]:
            assert _unpacked(wrapped.sums, first, last) == _unpacked(plain.sums, first, last)
        command = signal_command(5, doppler_hz=100.0, code_chips=-5.0)
        with np.errstate(over="ignore"):  # of numpy's scalars, when run as plain Python
            seen = [correlate(b.sums, command, RUNS, TAPS[1:4], 1) for b in (plain, wrapped)]
        np.testing.assert_array_equal(*seen)


@pytest.mark.parametrize(
    "info",
    [
        stream(2.6e6),
        stream(4.0e6, intermediate_hz=0.42e6),
        stream(12.0e6, is_complex=False, intermediate_hz=3e6),
        stream(200.0e6, intermediate_hz=1e6),  # thinned by two
        stream(300.0e6),  # thinned by three
    ],
    ids=["complex", "mixed", "real", "thinned", "thinned, not mixed"],
)
@given(cuts=st.lists(st.integers(1, 2000), max_size=6), data=st.data())
@settings(deadline=None, derandomize=True, max_examples=12)
def test_pieces_make_no_difference(info: StreamInfo, cuts: list[int], data: st.DataObject) -> None:
    """Whatever the blocks, and whatever was dropped before, entries are the same bits."""
    whole = _noise(info, 0, 2001)
    at_once = RunningSumBuffer(info, CARRIER_HZ, 2500)
    at_once.append(whole)
    pieces = RunningSumBuffer(info, CARRIER_HZ, 2500)
    edges = [0, *sorted(set(cuts)), 2001]
    dropped = data.draw(st.integers(0, 1500))
    for first, last in pairwise(edges):
        pieces.append(SampleBlock(info, first, whole.samples[first:last]))
    pieces.keep_from(dropped)
    assert pieces.end == at_once.end == 2001
    assert pieces.first <= dropped
    assert dropped - pieces.first < pieces.grain or pieces.first == 0
    skip = pieces.first // pieces.grain
    np.testing.assert_array_equal(pieces.sums.packed, at_once.sums.packed[skip:])


@pytest.mark.parametrize("per_byte", [1, 2, 4])
@pytest.mark.parametrize("info", [stream(2.6e6), stream(4.0e6, intermediate_hz=0.42e6)])
@given(cuts=st.lists(st.integers(1, 300), max_size=8))
@settings(deadline=None, derandomize=True, max_examples=25)
def test_packed_samples_add_up_to_the_same_bits(
    info: StreamInfo, per_byte: int, cuts: list[int]
) -> None:
    """Bytes cut anywhere between their samples, against the samples themselves."""
    generator = np.random.default_rng([per_byte, *cuts])
    table = generator.integers(-128, 127, (256, per_byte, 2), endpoint=True).astype(np.int8)
    data = generator.integers(0, 256, 301 // per_byte + 1).astype(np.uint8)
    whole = SampleBlock(info, 0, PackedSamples(data, table, 0, 301))
    plain, packed = (RunningSumBuffer(info, CARRIER_HZ, 400) for _ in range(2))
    plain.append(SampleBlock(info, 0, table[data].reshape(-1, 2)[:301]))
    for first, last in pairwise([0, *sorted(set(cuts)), 301, 301]):
        piece = data[first // per_byte : -(-last // per_byte)]
        held = PackedSamples(piece, table, first % per_byte, last - first)
        np.testing.assert_array_equal(held.unpacked(), whole.samples[first:last])
        packed.append(SampleBlock(info, first, held))
    np.testing.assert_array_equal(packed.sums.packed, plain.sums.packed)


@pytest.mark.parametrize("skip", [0, 1, 3])
@pytest.mark.parametrize("per_byte", [1, 2, 4])
@given(cuts=st.lists(st.integers(1, 300), max_size=8))
@settings(deadline=None, derandomize=True, max_examples=25)
def test_stretches_add_up_to_the_same_bits(per_byte: int, skip: int, cuts: list[int]) -> None:
    """Stretches of one block, packed or plain, against the block at once."""
    skip %= per_byte
    info, generator = stream(2.6e6), np.random.default_rng([per_byte, skip, *cuts])
    table = generator.integers(-128, 127, (256, per_byte, 2), endpoint=True).astype(np.int8)
    data = generator.integers(0, 256, (skip + 301) // per_byte + 2).astype(np.uint8)
    packed = SampleBlock(info, 0, PackedSamples(data, table, skip, 301))
    buffer = RunningSumBuffer(info, CARRIER_HZ, 400)
    buffer.append(SampleBlock(info, 0, packed.samples))
    for block in (packed, SampleBlock(info, 0, packed.samples)):
        source, total = buffer.summable(block), np.int64(0)
        for first, last in pairwise([0, *sorted(set(cuts)), 301]):
            out = np.empty(last - first, dtype=np.int64)
            with np.errstate(over="ignore"):
                total = sum_stretch(source, first, total, out)
            np.testing.assert_array_equal(out, buffer.sums.packed[first + 1 : last + 1])
            assert total == out[-1]


def test_mixed_or_thinned_samples_are_not_summed_as_they_are() -> None:
    for info in (
        stream(4.0e6, intermediate_hz=0.42e6),
        stream(12.0e6, is_complex=False, intermediate_hz=3.0e6),
        stream(250.0e6),
    ):
        assert not RunningSumBuffer(info, CARRIER_HZ, 400).as_they_are


def test_blocks_must_follow_each_other() -> None:
    buffer = RunningSumBuffer(stream(4.0e6), CARRIER_HZ, 100)
    with pytest.raises(ValueError, match="sample 7, expected 0"):
        buffer.append(_noise(stream(4.0e6), 7, 10))


@pytest.mark.parametrize("sample", [0, 123_456, 10**12])
def test_mixing_is_anchored_at_sample_0(sample: int) -> None:
    """Days into a recording the mixer's phase is still exact: Fractions say what it must be."""
    info = stream(5.0e6, is_complex=False, intermediate_hz=1_234_567.8)
    truth = signal_command(sample + 10, doppler_hz=500.0, code_chips=0.0, carrier_cycles=0.125)
    n = sample + np.arange(5100)
    seconds = (n - truth.sample) / info.sample_rate_hz
    turn = Fraction(info.intermediate_hz) / Fraction(info.sample_rate_hz)
    mixer = np.array([float(turn * int(k) % 1) for k in n])
    chips = ca_code(PRN)[np.floor(code_chips(truth, seconds)).astype(np.int64) % 1023]
    wave = 100.0 * chips * np.cos(2.0 * np.pi * (mixer + carrier_cycles(truth, seconds)))
    block = SampleBlock(info, sample, np.rint(wave).astype(np.int8))
    seen = correlate(running_sums(block, CARRIER_HZ), truth, RUNS, np.zeros(1), 1)[0, 0]
    assert np.degrees(np.angle(seen)) == pytest.approx(0.0, abs=0.2)


def test_what_does_not_fit_the_window_is_refused() -> None:
    """A compiled kernel would write past the end."""
    info = stream(4.0e6)
    buffer = RunningSumBuffer(info, CARRIER_HZ, 100)
    buffer.append(_noise(info, 0, 90))
    with pytest.raises(ValueError, match="do not fit"):
        buffer.append(_noise(info, 90, 90))
    buffer.keep_from(85)
    buffer.append(_noise(info, 90, 90))
    assert (buffer.first, buffer.end) == (85, 180)


def test_thinned_sums_lose_next_to_nothing() -> None:
    """200 Msps kept at every second entry: the prompt's edges are off by a quarter entry each."""
    info = stream(200.0e6)
    truth = signal_command(31, doppler_hz=3000.0, code_chips=-0.5)
    block = sampled(info, PRN, truth, 0, 200_500)
    sums = running_sums(block, CARRIER_HZ)
    assert sums.step == 2
    seen = correlate(sums, truth, RUNS, TAPS[:5], 1)[0]
    wanted = brute_force(block, PRN, truth, TAPS[:5], 1)[0]
    for tap in range(1, 4):
        loss_db, phase_deg = _loss_and_phase(seen[tap], wanted[tap])
        assert abs(loss_db) < 0.03
        assert abs(phase_deg) < 0.2


def test_a_block_may_start_off_the_thinning_s_grid() -> None:
    info = stream(200.0e6)
    sums = running_sums(_noise(info, 1001, 4000), CARRIER_HZ)
    assert sums.first == 1002
    assert sums.packed.size == (4000 - 1) // 2 + 1


# --- resampling ----------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [2.046e6, 1.023e6 * 4])
def test_resampled_values_are_sums_of_what_falls_into_them(rate_hz: float) -> None:
    """Against linear interpolation of the plain cumulative sum."""
    block = _noise(stream(5.0e6), 0, 5000)
    out = resample(running_sums(block, CARRIER_HZ), 40, rate_hz, 1500)
    total = np.concatenate([[0.0], np.cumsum(block.samples[:, 0] + 1j * block.samples[:, 1])])
    edges = 40 + np.arange(1501) * 5.0e6 / rate_hz
    at_edges = np.interp(edges, np.arange(5001), total.real) + 1j * np.interp(
        edges, np.arange(5001), total.imag
    )
    np.testing.assert_allclose(out, np.diff(at_edges), rtol=1e-5, atol=1e-2)
