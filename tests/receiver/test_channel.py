"""Channels on simulated samples against the truth that made them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from simulated_sky import (
    BLOCKED_1_S,
    BLOCKED_5_S,
    CODE_CHIPS,
    STEADY_DBHZ,
    Sky,
    Track,
    effective_cn0_dbhz,
    shared_sky,
    start_channel,
    track,
)

from deepgnss.core.records import FloatArray
from deepgnss.receiver.interval import Interval
from deepgnss.receiver.modes import CarrierSettings, Mode, TrackingSettings
from deepgnss.theory.tracking_error import dll_thermal_sigma_chips, pll_thermal_sigma_cycles

BANDWIDTH_HZ, CODE_BANDWIDTH_HZ, SPACING_CHIPS = 7.0, 1.0, 0.25
SETTINGS = TrackingSettings(
    CarrierSettings(bandwidth_hz=BANDWIDTH_HZ),
    code_bandwidths_hz=(3.0, CODE_BANDWIDTH_HZ),
    spacing_chips=SPACING_CHIPS,
)
SETTLED_S = 2.5


@cache
def _tracks() -> dict[str, Track]:
    """Every satellite of the shared sky, started with errors as acquisition leaves them."""
    sky, generator = shared_sky(), np.random.default_rng(1)
    channels = [
        start_channel(
            sky,
            emitter.satellite,
            SETTINGS,
            code_error_chips=generator.uniform(-0.15, 0.15),
            doppler_error_hz=generator.uniform(-8.0, 8.0),
        )
        for emitter in sky.scenario.emitters
    ]
    return track(sky, channels)


def _satellite(schedule: float | tuple[tuple[float, float], ...]) -> str:
    wanted = schedule if isinstance(schedule, tuple) else ((0.0, schedule),)
    return next(e.satellite for e in shared_sky().scenario.emitters if e.cn0_dbhz == wanted)


def _settled(one: Track) -> list[Interval]:
    return [i for i in one.intervals if i.command.sample > SETTLED_S * shared_sky().rate_hz]


def _seconds(sky: Sky, sample: int) -> float:
    return sample / sky.rate_hz


def _carrier_errors(sky: Sky, satellite: str, intervals: list[Interval]) -> FloatArray:
    """Generator − truth, cycles; whole cycles and the half of the bit's sign taken off once."""
    samples = np.array([i.command.sample for i in intervals])
    local = np.array([i.command.carrier_cycles for i in intervals])
    difference = local - sky.truth(satellite, samples).carrier_cycles
    return np.asarray(difference - np.round(2.0 * np.median(difference)) / 2.0)


def _code_errors(sky: Sky, satellite: str, intervals: list[Interval]) -> FloatArray:
    """Generator − truth, chips."""
    samples = np.array([i.command.sample for i in intervals])
    local = np.array([i.command.code_chips for i in intervals])
    difference = local - sky.truth(satellite, samples).code_chips
    return np.asarray(np.mod(difference + CODE_CHIPS / 2, CODE_CHIPS) - CODE_CHIPS / 2)


# --- lock ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("cn0_dbhz", STEADY_DBHZ)
def test_lock_and_its_order(cn0_dbhz: float) -> None:
    sky, one = shared_sky(), _tracks()[_satellite(cn0_dbhz)]
    order = [event.what for event in one.events if event.what != "false lock"]
    assert order == ["FLL", "bit sync", "PLL", "phase lock"]
    locked_s = _seconds(sky, one.event("phase lock").sample)
    assert locked_s < (0.55 if cn0_dbhz >= 34.0 else 1.0)
    assert _seconds(sky, one.event("bit sync").sample) < (0.35 if cn0_dbhz >= 34.0 else 0.8)
    assert one.channel.mode is Mode.PHASE


@pytest.mark.parametrize("cn0_dbhz", STEADY_DBHZ)
def test_symbol_edges_are_where_the_satellite_s_bits_change(cn0_dbhz: float) -> None:
    sky, satellite = shared_sky(), _satellite(cn0_dbhz)
    one = _tracks()[satellite]
    assert one.channel.edge is not None
    edges = [i for i in one.intervals if (i.periods - one.channel.edge) % 20 == 0]
    sent_s = sky.truth(satellite, np.array([i.command.sample for i in edges])).sent_s
    from_edge_s = np.abs(np.mod(sent_s + 0.01, 0.02) - 0.01)
    assert np.max(from_edge_s) < 1e-6


@pytest.mark.parametrize("cn0_dbhz", STEADY_DBHZ)
def test_bits_are_those_sent(cn0_dbhz: float) -> None:
    """Also those of the stretch before phase lock, demodulated looking back."""
    sky, satellite = shared_sky(), _satellite(cn0_dbhz)
    channel, one = _tracks()[satellite].channel, _tracks()[satellite]
    symbols = np.frombuffer(bytes(channel.symbols), dtype=np.int8)
    last = one.intervals[-1]
    sent_s = sky.truth(satellite, np.array([last.command.sample])).sent_s[0]
    periods = channel.symbols_first + 20 * np.arange(symbols.size) - last.periods
    sent = sky.symbols(satellite, sent_s + 1e-3 * periods + 0.01)
    wrong = symbols != sent
    if np.mean(wrong) > 0.5:  # half a cycle: every sign turned
        wrong = ~wrong
    locked = (one.event("phase lock").sample / sky.rate_hz - 0.2) * 50
    assert not np.any(wrong[int(locked) :])
    assert np.mean(wrong) < 0.05


def test_fresh_channels_promise_nothing() -> None:
    """No range while pulling in, no phase before lock."""
    for one in _tracks().values():
        locked = one.event("phase lock").sample
        for interval in one.intervals:
            if interval.command.sample < one.event("FLL").sample:
                assert not interval.code_valid
            if interval.command.sample < locked:
                assert not interval.phase_valid


# --- accuracy ------------------------------------------------------------------------------------


def test_carrier_phase_has_the_noise_of_theory_and_no_bias() -> None:
    """T(2.20) with the C/N0 that noise and the other satellites leave."""
    sky = shared_sky()
    normalized = []
    for cn0_dbhz in STEADY_DBHZ:
        satellite = _satellite(cn0_dbhz)
        errors = _carrier_errors(sky, satellite, _settled(_tracks()[satellite]))
        assert np.max(np.abs(errors)) < 0.1, satellite  # no slip
        sigma = pll_thermal_sigma_cycles(effective_cn0_dbhz(sky, satellite), BANDWIDTH_HZ, 0.02)
        normalized.append(errors / sigma)
    assert 0.85 < np.std(np.concatenate(normalized)) < 1.15
    assert abs(np.mean(np.concatenate(normalized))) < 0.1


def test_code_phase_has_the_noise_of_theory_and_no_bias() -> None:
    """Near T(2.25); a fine spacing on coarse samples has somewhat less."""
    sky = shared_sky()
    normalized = []
    for cn0_dbhz in STEADY_DBHZ:
        satellite = _satellite(cn0_dbhz)
        errors = _code_errors(sky, satellite, _settled(_tracks()[satellite]))
        sigma = dll_thermal_sigma_chips(
            effective_cn0_dbhz(sky, satellite),
            CODE_BANDWIDTH_HZ,
            0.02,
            SPACING_CHIPS,
            sky.rate_hz,
            1.023e6,
        )
        normalized.append(errors / sigma)
        assert abs(np.mean(errors)) < 3.0 * sigma / np.sqrt(2.0 * CODE_BANDWIDTH_HZ * 7.5) + 0.001
    assert 0.65 < np.std(np.concatenate(normalized)) < 1.15


def test_code_and_carrier_stay_together() -> None:
    """Slope of generator code over generator carrier: 1/1540, but for the ionosphere's."""
    sky, slopes = shared_sky(), []
    for cn0_dbhz in STEADY_DBHZ:
        satellite = _satellite(cn0_dbhz)
        intervals = _settled(_tracks()[satellite])
        t = np.array([i.command.sample for i in intervals]) / sky.rate_hz
        difference = _code_errors(sky, satellite, intervals) - (
            _carrier_errors(sky, satellite, intervals) / 1540.0
        )
        slopes.append(np.polyfit(t, difference, 1)[0] * 293.0)
    mean = np.average(slopes, weights=10.0 ** (0.1 * np.array(STEADY_DBHZ)))
    assert abs(mean) < 0.12  # m/s, σ 0.05; 1 Hz of wrong aiding would be 0.19 m/s


@pytest.mark.parametrize("cn0_dbhz", STEADY_DBHZ)
def test_cn0_is_right_to_three_tenths(cn0_dbhz: float) -> None:
    satellite = _satellite(cn0_dbhz)
    seen = np.mean([i.cn0_dbhz for i in _settled(_tracks()[satellite])])
    assert seen == pytest.approx(effective_cn0_dbhz(shared_sky(), satellite), abs=0.3)


def test_doppler_is_positive_when_range_shrinks() -> None:
    sky = shared_sky()
    for cn0_dbhz in STEADY_DBHZ:
        satellite = _satellite(cn0_dbhz)
        last = _tracks()[satellite].intervals[-1].command
        ends = sky.truth(satellite, np.array([last.sample - 2600, last.sample + 2600]))
        truth_hz = (ends.carrier_cycles[1] - ends.carrier_cycles[0]) / 2e-3
        assert last.carrier_hz == pytest.approx(truth_hz, abs=1.5)
        assert last.code_hz == pytest.approx(1.023e6 + truth_hz / 1540.0, abs=0.05)


@pytest.mark.parametrize("coherent_ms", [1, 2, 4, 5, 10])
@pytest.mark.parametrize("order", [2, 3])
def test_every_coherent_time_and_order_locks(coherent_ms: int, order: int) -> None:
    sky, satellite = shared_sky(), _satellite(44.0)
    settings = TrackingSettings(CarrierSettings(f"pll{order}", 15.0, 1e-3 * coherent_ms))
    channel = start_channel(sky, satellite, settings, doppler_error_hz=4.0)
    one = track(sky, [channel], 2.4)[satellite]
    assert [event.what for event in one.events] == ["FLL", "bit sync", "PLL", "phase lock"]
    late = [i for i in one.intervals if i.command.sample > 1.4 * sky.rate_hz]
    errors = _carrier_errors(sky, satellite, late)
    sigma = pll_thermal_sigma_cycles(44.0, 15.0, 1e-3 * coherent_ms)
    assert np.max(np.abs(errors)) < 5.0 * sigma
    assert np.std(errors) == pytest.approx(sigma, rel=0.35)
    assert late[-1].cn0_dbhz == pytest.approx(44.0, abs=1.0)


# --- false lock, blockage ------------------------------------------------------------------------


@pytest.mark.parametrize("off_hz", [25.0, -25.0])
@pytest.mark.parametrize("valid", [False, True], ids=["before lock", "while locked"])
def test_false_lock_is_found_and_left(off_hz: float, valid: bool) -> None:
    """A loop pushed by 25 Hz sees the same cos 2φ; it must be back within two seconds."""
    sky, satellite = shared_sky(), _satellite(40.0)
    channel = start_channel(sky, satellite, SETTINGS)
    at_s = 1.0 if valid else 0.42
    track_before = track(sky, [channel], at_s)[satellite]
    assert channel.mode is Mode.PHASE
    assert track_before.intervals[-1].phase_valid == valid
    slips = channel.slips
    channel.nco.change(off_hz=off_hz)
    channel.history[-1] = channel._interval()
    channel._plan()
    rest = track(sky, [channel], 3.0, start_s=at_s)[satellite]
    assert f"moved by {-off_hz:+.0f} Hz" in rest.event("false lock").reason
    found_s = _seconds(sky, rest.event("false lock").sample) - at_s
    assert found_s < 1.2
    back = rest.event("phase lock")
    assert _seconds(sky, back.sample) - at_s < 2.0
    assert channel.slips > slips
    assert channel.half_cycle is None
    late = [i for i in rest.intervals if i.command.sample > back.sample + 0.3 * sky.rate_hz]
    assert np.max(np.abs(_carrier_errors(sky, satellite, late))) < 0.06


def test_a_second_s_blockage_is_held_and_counted_as_a_slip() -> None:
    sky, satellite = shared_sky(), _satellite(BLOCKED_1_S)
    one = _tracks()[satellite]
    events = {event.what: _seconds(sky, event.sample) for event in one.events}
    assert 4.0 < events["hold"] < 4.25
    assert [e.what for e in one.events][-4:] == ["hold", "FLL", "PLL", "phase lock"]
    assert events["phase lock"] < 6.0
    before = [i for i in one.intervals if 3.0 < _seconds(sky, i.command.sample) < 4.0]
    gone = [i for i in one.intervals if 4.3 < _seconds(sky, i.command.sample) < 5.0]
    after = [i for i in one.intervals if _seconds(sky, i.command.sample) > events["phase lock"]]
    assert all(i.phase_valid and i.code_valid for i in before)
    assert not any(i.phase_valid or i.code_valid for i in gone)
    assert all(i.phase_valid for i in after[1:])
    assert after[-1].slips > before[-1].slips
    assert one.channel.half_cycle is None
    # The generators coasted through it: code is back without a search.
    late = [i for i in after if _seconds(sky, i.command.sample) > 7.0]
    assert np.max(np.abs(_code_errors(sky, satellite, late))) < 0.02
    assert np.max(np.abs(_carrier_errors(sky, satellite, late))) < 0.03


def test_five_seconds_lose_the_signal() -> None:
    sky = shared_sky()
    one = _tracks()[_satellite(BLOCKED_5_S)]
    assert one.channel.mode is Mode.LOST
    assert one.events[-1].what == "lost"
    held_s = (one.events[-1].sample - one.event("hold").sample) / sky.rate_hz
    assert held_s == pytest.approx(SETTINGS.lost_after_s, abs=0.03)


def test_noise_is_not_kept() -> None:
    """A satellite that is not there: lost within two seconds, never a range."""
    sky = shared_sky()
    absent = next(p for p in range(1, 31) if f"G{p:02d}" not in _tracks())
    present = _satellite(44.0)
    channel = start_channel(sky, present, SETTINGS)
    other = type(channel)(
        channel.signal,
        absent,
        SETTINGS,
        sample_rate_hz=sky.rate_hz,
        sample=1000,
        code_chips=100.0,
        doppler_hz=500.0,
    )
    one = track(sky, [other], 3.0)[other.satellite]
    assert other.mode is Mode.LOST
    assert not any(i.code_valid or i.phase_valid for i in one.intervals)


# --- independence --------------------------------------------------------------------------------


@pytest.mark.parametrize("epoch_s", [0.0131, 0.04, 1.0])
def test_results_do_not_depend_on_how_the_samples_come(epoch_s: float) -> None:
    """Every command and every decision, to the last bit."""
    sky, satellites = shared_sky(), [_satellite(44.0), _satellite(34.0)]
    runs = []
    for length_s in (0.1, epoch_s):
        channels = [start_channel(sky, s, SETTINGS, doppler_error_hz=3.0) for s in satellites]
        runs.append(track(sky, channels, 1.5, length_s))
    for satellite in satellites:
        one, other = (run[satellite] for run in runs)
        count = min(len(one.intervals), len(other.intervals)) - 1
        assert count > 60
        assert one.intervals[:count] == other.intervals[:count]
        assert one.events == other.events


def test_only_listed_transitions_are_possible() -> None:
    channel = start_channel(shared_sky(), _satellite(44.0), SETTINGS)
    with pytest.raises(ValueError, match="no way from PULL_IN to PHASE"):
        channel._go(Mode.PHASE, "by force")
    channel.drop("test")
    assert channel.mode is Mode.LOST
    channel.run(None)  # type: ignore[arg-type]  # looks at nothing any more


def test_polarity_is_told_once() -> None:
    channel = start_channel(shared_sky(), _satellite(44.0), SETTINGS)
    channel.set_polarity(0.5)
    assert (channel.half_cycle, channel.slips) == (0.5, 1)
    channel.set_polarity(0.0)
    assert (channel.half_cycle, channel.slips) == (0.5, 1)


def test_a_polarity_by_the_arc_before_holds_until_symbols_tell() -> None:
    channel = start_channel(shared_sky(), _satellite(44.0), SETTINGS)
    channel.rejoin(0.5)
    assert channel.half_cycle is None  # no phase to speak of
    channel.phase_valid = True
    channel.rejoin(0.5)
    channel.rejoin(0.0)
    assert (channel.half_cycle, channel.slips) == (0.5, 1)
    channel.set_polarity(0.0)
    assert (channel.half_cycle, channel.slips) == (0.0, 2)
    assert channel.events[-1].what == "cycle slip"
