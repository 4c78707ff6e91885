"""Streams, antennas, signals and reflected rays: samples against the defining formulas."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from demodulation import Truth, as_complex, demodulate, phase_cycles

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import ConfigError
from deepgnss.core.records import BDS_B1I, GPS_L1CA, FloatArray, Oscillator
from deepgnss.core.time import GpsTime
from deepgnss.receiver.signals import signal_of
from deepgnss.sim import generator
from deepgnss.sim.constellation import nominal
from deepgnss.sim.delays import hermite_cubics, node_source, receive
from deepgnss.sim.generator import notes, pieces, recording, sample_source
from deepgnss.sim.motion.attitude import Steady
from deepgnss.sim.motion.paths import Line, Path, Static
from deepgnss.sim.motion.profile import acceleration_profile
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.orbits import orbit_of
from deepgnss.sim.rows import STENCIL, row_source, symbols_of
from deepgnss.sim.scenario import (
    Antenna,
    Arrivals,
    Emitter,
    FrontEnd,
    ReceiverClock,
    Scenario,
    Stream,
    View,
)
from deepgnss.sim.sky import elevations

START = GpsTime(2290, 382_256.25)
L1 = Stream("L1", FrontEnd(4.0e6, "float32"))
B1 = Stream("B1", FrontEnd(5.0e6, "float32", centre_hz=BDS_B1I.carrier_hz - 3.0e5))
WIDE = Stream("wide", FrontEnd(24.0e6, "float32", centre_hz=1_568.0e6))
CLOCK = ReceiverClock(offset_s=3.0e-4, drift_sps=2.0e-7)


def _scenario(
    streams: tuple[Stream, ...] = (L1,),
    path: Path | None = None,
    start: GpsTime = START,
    seconds: float = 3.0,
) -> Scenario:
    """The highest GPS satellite, BeiDou MEO and GEO over central Asia; no noise."""
    vehicle = Vehicle(0.6, 1.6, 120.0, path or Static(), Steady(yaw_rad=0.7))
    nav = nominal(start, seconds, "GC")
    seen = elevations(nav, start, vehicle)
    highest = sorted(seen, key=lambda satellite: -seen[satellite])
    chosen = [next(s for s in highest if s[0] == "G")]
    chosen += [next(s for s in highest if s in ("C01", "C02", "C03", "C04", "C05"))]
    chosen += [next(s for s in highest if s[0] == "C" and 5 < int(s[1:]) < 59)]
    names = {"G": GPS_L1CA.name, "C": BDS_B1I.name}
    emitters = tuple(
        Emitter(s, ((0.0, 45.0),), signal_of(names[s[0]], int(s[1:])))
        for s in chosen
        if any(t.front_end.hears(signal_of(names[s[0]], int(s[1:])).id) for t in streams)
    )
    return Scenario(
        "test", start, seconds, vehicle, emitters, nav, streams, clock=CLOCK, noise=False
    )


@pytest.mark.parametrize(
    ("streams", "heard"),
    [((L1, B1), {0: "G", 1: "CC"}), ((WIDE,), {0: "GCC"}), ((B1, L1), {0: "CC", 1: "G"})],
    ids=["two", "wide", "other order"],
)
def test_every_signal_in_every_stream_that_hears_it(
    streams: tuple[Stream, ...], heard: dict[int, str]
) -> None:
    scenario = _scenario(streams)
    for index, systems in heard.items():
        front_end = streams[index].front_end
        emitters = [e for e in scenario.emitters if front_end.hears(e.signal.id)]
        assert "".join(e.satellite[0] for e in emitters) == systems
        for emitter in emitters:
            alone = replace(scenario, emitters=(emitter,))
            starts = Truth(alone, emitter, index).code_starts(100_000, 1200)
            count = round(0.999e-3 * front_end.sample_rate_hz)
            sums = demodulate(alone, emitter, np.ceil(starts[[0, 7, 500, 1199]]), count, index)
            assert np.abs(phase_cycles(sums)).max() < 1.0e-4
            level = np.sqrt(2.0 * 10.0**4.5 / front_end.sample_rate_hz)
            assert np.abs(sums) == pytest.approx(level, rel=1e-3)
        together = sum(
            sample_source(replace(scenario, emitters=(e,)), index)(50_001, 3000) for e in emitters
        )
        np.testing.assert_allclose(
            sample_source(scenario, index)(50_001, 3000), together, atol=2e-6
        )


@pytest.mark.parametrize("index", [0, 1, 2])
def test_symbols_and_secondary_code_leave_at_their_time(index: int) -> None:
    """Sign of every code period against message × NH code, counted from the system's own week."""
    scenario = _scenario((WIDE,))
    emitter = scenario.emitters[index]
    scenario = replace(scenario, emitters=(emitter,))
    truth = Truth(scenario, emitter)
    starts = truth.code_starts(500_000, 60)
    sums = demodulate(scenario, emitter, np.ceil(starts), 23_970)
    sent_ms = np.round(1e3 * (truth.at(starts)[1] + np.floor(START.tow_s))).astype(int)
    if emitter.satellite[0] == "C":
        sent_ms -= 14_000
    signal, symbols = emitter.signal, symbols_of(scenario, emitter)
    zero = symbols.first - (14_000 // signal.symbol_periods if index else 0)
    expected = symbols.values[sent_ms // signal.symbol_periods - zero].astype(int)
    if signal.secondary_code:
        expected *= np.array(signal.secondary_code)[sent_ms % 20]
    np.testing.assert_array_equal(np.sign(sums.real), expected)
    assert len(set(expected)) == 2


@pytest.mark.parametrize("is_complex", [True, False], ids=["iq", "real"])
def test_inverted_spectrum(is_complex: bool) -> None:
    """RF 0.4 MHz above the centre comes out 0.4 MHz below the IF, and phases run backwards."""
    front_end = FrontEnd(
        8.0e6, "float32", is_complex=is_complex, centre_hz=GPS_L1CA.carrier_hz - 4.0e5,
        intermediate_hz=2.1e6, inverted=True,
    )  # fmt: skip
    scenario = _scenario((Stream("L1", front_end),))
    emitter = scenario.emitters[0]
    sums = demodulate(scenario, emitter, np.array([77_777, 9_999_999]), 8000)
    assert np.abs(phase_cycles(sums)).max() < 1.0e-3
    spectrum = np.abs(np.fft.fft(as_complex(sample_source(scenario)(0, 1 << 16)))) ** 2
    f_hz = np.fft.fftfreq(1 << 16, 1.0 / 8.0e6)
    inside = (f_hz > 0.0) & (f_hz < 3.4e6)
    middle_hz = np.sum(f_hz[inside] * spectrum[inside]) / np.sum(spectrum[inside])
    assert middle_hz == pytest.approx(1.7e6, abs=3.0e4)
    assert not replace(front_end, intermediate_hz=3.7e6, is_complex=True).hears(BDS_B1I)


def test_an_antenna_on_a_lever_hears_its_own_phase() -> None:
    """A metre to the right of a vehicle that heads for azimuth 0.7."""
    other = Stream("second", L1.front_end, antenna=1)
    antennas = (Antenna("main", (0.0, 0.0, 0.0)), Antenna("right", (0.0, 1.0, 0.0)))
    scenario = replace(_scenario(), streams=(L1, other), antennas=antennas)
    emitter = scenario.emitters[0]
    firsts = np.array([10_000, 9_000_001])
    for index in (0, 1):
        sums = demodulate(scenario, emitter, firsts, 400, index)
        assert np.abs(phase_cycles(sums)).max() < 1.0e-4
    main, right = (Truth(scenario, emitter, index).at(firsts)[0] for index in (0, 1))
    orbit = orbit_of(scenario.orbit_set(emitter.satellite), START)
    sight = receive(scenario, emitter, orbit, firsts / 4.0e6)
    toward = np.cos(sight.elevation_rad) * np.cos(sight.azimuth_rad - (0.7 + np.pi / 2.0))
    wavelength_m = SPEED_OF_LIGHT_MPS / GPS_L1CA.carrier_hz
    assert right - main == pytest.approx(toward / wavelength_m, abs=2e-5)


@dataclass(frozen=True)
class _Wall:
    """No line of sight for a while, and a ray that comes and goes with a growing detour."""

    rays: int = 2

    def arrivals(self, view: View, carrier_hz: float) -> Arrivals:
        t_s = view.t_s
        direct = np.where((t_s > 0.5) & (t_s < 1.0), 0.0, 1.0)
        heard = (t_s > 0.7) & (t_s < 2.2)
        ray = np.where(heard, 0.5, 0.0)
        excess_m = np.where(heard, 60.0 + 20.0 * t_s, np.nan)
        none = np.zeros((1, t_s.size))
        return Arrivals(direct, np.vstack([none, ray]), np.vstack([none, excess_m]))


def test_reflected_rays_are_late_turned_and_weaker() -> None:
    free = _scenario()
    scenario = replace(free, surroundings=_Wall())
    emitter = scenario.emitters[0]
    truth = Truth(scenario, emitter)

    def ray(first: int, count: int) -> tuple[FloatArray, FloatArray]:
        """Carrier and satellite time of the ray."""
        cycles, sent_s = truth.between(first, count)
        t_s = np.arange(first, first + count) / 4.0e6 * (1.0 - 2.0e-7) - 3.0e-4
        excess_s = (60.0 + 20.0 * t_s) / SPEED_OF_LIGHT_MPS
        late = cycles - GPS_L1CA.carrier_hz * excess_s
        return late, sent_s - excess_s

    level = np.sqrt(2.0 * 10.0**4.5 / 4.0e6)
    for first in (2_900_000, 3_600_123, 8_000_000):
        late, sent_s = ray(first, 3990)
        samples = as_complex(sample_source(scenario)(first, 3990))
        blocked = first < 4_000_000
        rest = samples if blocked else samples - as_complex(sample_source(free)(first, 3990))
        wiped = rest * np.exp(-2j * np.pi * np.mod(late, 1.0)) * truth.code_at(sent_s)
        # the data bit of the line of sight: it has the sign of the free signal
        free_sums = as_complex(sample_source(free)(first, 3990)) * truth.local(first, 3990)
        sign = np.sign(free_sums.real)
        mean = np.mean(wiped * sign)
        assert mean.real == pytest.approx(-0.5 * level, rel=6e-3)
        assert abs(mean.imag) < 1e-3 * level
    dark = sample_source(scenario)(2_100_000, 4000)
    assert not dark.any()
    assert np.isfinite(sample_source(scenario)(0, 12_000_000)).all()


def test_blockage_steps_lie_on_the_milliseconds_and_cut_anywhere() -> None:
    scenario = replace(_scenario(), surroundings=_Wall())
    whole = sample_source(scenario)(1_990_000, 1_000_000)
    heard = whole.any(axis=0)
    edges = np.flatnonzero(np.diff(heard.astype(int))) + 1 + 1_990_000
    assert len(edges) == 2
    assert not np.any(edges % 4000)
    # times of blockage are true ones: 0.3 ms of clock
    assert edges / 4.0e6 == pytest.approx([0.5, 0.7], abs=1.4e-3)
    for first, count in ((1_999_000, 7), (2_003_999, 2), (2_799_000, 5_001), (2_795_999, 12_002)):
        part = sample_source(scenario)(first, count)
        np.testing.assert_array_equal(part, whole[:, first - 1_990_000 :][:, :count])


def test_phase_is_smooth_through_a_step_of_jerk() -> None:
    """100 g at 100 g/s along the line of sight: cubics against travel times at odd instants."""
    direction = np.array([0.05, -0.02, -0.998])
    path = Line(
        tuple(direction / np.linalg.norm(direction)),
        acceleration_profile([(0.4007, 981.0), (1.6003, -981.0)], 981.0),
    )
    scenario = replace(_scenario(path=path, seconds=5.0), ionosphere=False)
    emitter = scenario.emitters[0]
    truth = Truth(scenario, emitter)
    ms = np.arange(300, 3900)
    window = node_source(scenario)(300 - STENCIL[0], 3900 + STENCIL[1])
    carrier, code = (
        hermite_cubics(delay_s[:1] * GPS_L1CA.carrier_hz)[0]
        for delay_s in (window.carrier_s, window.code_s)
    )
    for u in (0.137, 0.5, 0.861):
        cycles, sent_s = truth.at((ms + u) * 4000.0)
        late_s = START.tow_s % 1.0 + (ms + u) * 1e-3 - sent_s
        powers = u ** np.arange(4)
        assert np.abs(carrier @ powers + cycles).max() < 5.0e-6
        assert np.abs(code @ powers - late_s * GPS_L1CA.carrier_hz).max() < 5.0e-6


def test_code_and_carrier_stay_together_for_minutes() -> None:
    """f·(satellite time) by chips and by carrier differ by what mixing took off, and no more."""
    scenario = replace(_scenario(seconds=700.0), ionosphere=False)
    front_end = FrontEnd(4.0e6, "float32", centre_hz=1_574.9e6, intermediate_hz=1.25e5)
    rows, nodes = row_source(scenario, front_end), node_source(scenario)
    for first_ms in (0, 60_000, 599_000):
        made = rows(nodes(first_ms - STENCIL[0], first_ms + 500 + STENCIL[1]), first_ms)
        ms = first_ms + np.arange(500)
        assert made.carrier_cycles.shape == (1, 500, 4)
        # whole code periods are whole carrier cycles but for 1540·1023 per period
        chips = made.chip[0] + made.code_chips[0, :, 0]
        by_code = np.mod(chips * 1540.0, 1.0)
        taken = (front_end.centre_hz - front_end.intermediate_hz) * 1.0e-3 * ms
        apart = by_code - made.carrier_cycles[0, :, 0] - np.mod(taken, 1.0)
        start = np.mod(GPS_L1CA.carrier_hz * (START.tow_s % 1.0), 1.0)
        apart = np.mod(apart - start + 0.5, 1.0) - 0.5
        assert np.abs(apart).max() < 1.0e-6


def test_recordings_go_on_through_the_end_of_the_week() -> None:
    scenario = _scenario((L1, B1), start=GpsTime(2290, 604_798.25))
    for index in (0, 1):
        emitters = [
            e for e in scenario.emitters if scenario.streams[index].front_end.hears(e.signal.id)
        ]
        alone = replace(scenario, emitters=(emitters[0],))
        rate_hz = scenario.streams[index].front_end.sample_rate_hz
        starts = Truth(alone, emitters[0], index).code_starts(round(1.70 * rate_hz), 300)
        sums = demodulate(
            alone, emitters[0], np.ceil(starts[::13]), round(0.999e-3 * rate_hz), index
        )
        assert np.abs(phase_cycles(sums)).max() < 1.0e-4
        assert np.abs(sums).min() > 0.999 * np.abs(sums).max()


def test_same_bytes_for_any_threads_and_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    streams = (
        Stream("L1", FrontEnd(3.1e6, "bits2")),
        Stream("B1", FrontEnd(4.1e6, "int8", centre_hz=BDS_B1I.carrier_hz, bandwidth_hz=3.5e6)),
    )
    noisy = replace(
        _scenario(streams, seconds=1.3),
        noise=True,
        surroundings=_Wall(),
        clock=replace(CLOCK, oscillator=Oscillator("t", 1e-21, 1e-21, 2e-20, 1e-9)),
    )

    def made(threads: int) -> list[bytes]:
        out = [b"", b""]
        for piece in pieces(noisy, threads):
            out[piece.stream] += piece.data
        return out

    once = made(1)
    assert [len(data) for data in once] == [
        round(noisy.sample_count(s) * s.front_end.bytes_per_second / s.front_end.sample_rate_hz)
        for s in streams
    ]
    assert made(2) == once
    assert b"".join(recording(noisy, 1, threads=3)) == once[1]
    monkeypatch.setattr(generator, "PIECE_SAMPLES", 70_008)
    assert made(3) == once
    assert once[0][:1000] != made(1)[1][:1000]


def test_streams_that_cannot_be_are_refused() -> None:
    scenario = _scenario((L1, B1))
    with pytest.raises(ConfigError, match="BDS_B1I"):
        replace(scenario, streams=(L1,))
    with pytest.raises(ConfigError, match="antenna 1"):
        replace(scenario, streams=(L1, replace(B1, antenna=1)))
    slow = Stream("L1", FrontEnd(1.03e6))
    assert slow.front_end.hears(GPS_L1CA)
    assert not FrontEnd(1.0e6).hears(GPS_L1CA)
    assert sample_source(replace(_scenario((slow,))), 0)(0, 8).shape == (2, 8)


def test_rates_in_step_with_the_chips_are_told() -> None:
    """Four or four and a half samples per chip hide delays below their spacing; 4 Msps do not."""
    for rate_hz, grid_m in ((4.092e6, 73.3), (4.6035e6, 32.6), (4.0e6, None), (16.0e6, None)):
        front_end = FrontEnd(rate_hz, "float32")
        assert front_end.grid_m(GPS_L1CA) == (grid_m and pytest.approx(grid_m, abs=0.05))
        scenario = _scenario((Stream("L1", front_end),))
        assert len(notes(scenario)) == (grid_m is not None)
    in_step = Truth(
        scenario := _scenario((Stream("L1", FrontEnd(4.092e6, "float32")),)), scenario.emitters[0]
    )
    place = np.mod(in_step.code_starts(0, 20), 1.0)
    assert np.ptp(place) < 0.02  # edges keep their place: 3 Hz of code Doppler
