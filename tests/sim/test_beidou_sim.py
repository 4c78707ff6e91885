"""BeiDou in the simulator: orbits, ionosphere, constellation, messages, samples."""

from __future__ import annotations

import itertools
import warnings
from pathlib import Path

import georinex
import numpy as np
import pytest

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.core.errors import ConfigError
from deepgnss.core.frames import ecef
from deepgnss.core.records import BDS_B1I, Ephemeris, NavData
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_nav import read_nav, write_nav
from deepgnss.receiver import atmosphere, orbits
from deepgnss.receiver.beidou_nav import D1, D2, encode_d1, encode_d2
from deepgnss.receiver.messages import IonoUtc
from deepgnss.receiver.signals import (
    BDS_B1I_D1,
    BDS_B1I_D2,
    NH20,
    Signal,
    b1i_code,
    signal_of,
)
from deepgnss.sim.atmosphere import ionosphere_of
from deepgnss.sim.constellation import BEIDOU_KLOBUCHAR, KLOBUCHAR, nominal
from deepgnss.sim.delays import receive
from deepgnss.sim.generator import sample_source
from deepgnss.sim.motion.paths import Static
from deepgnss.sim.motion.vehicle import Vehicle
from deepgnss.sim.navbits import Symbols, sent_symbols
from deepgnss.sim.orbits import orbit_of, travel
from deepgnss.sim.scenario import Emitter, FrontEnd, ReceiverClock, Scenario, Stream

START = GpsTime(2290, 382_256.25)
END_OF_WEEK = GpsTime(2290, 604_790.0)
PLACE = ecef(np.radians(52.264), np.radians(10.526), 120.0)
NAV = nominal(START, 60.0, "GC")


def one_of(satellite: str, nav: NavData = NAV) -> Ephemeris:
    return nav.ephemerides[satellite][0]


def of_satellite(satellite: str) -> Signal:
    return signal_of("BDS_B1I" if satellite[0] == "C" else "GPS_L1CA", int(satellite[1:]))


# --- orbits and ionosphere -----------------------------------------------------------------------


def test_travel_agrees_with_the_receivers_prediction() -> None:
    """All kinds of orbits, by two programs that share nothing but the elements."""
    sets = [one_of(satellite) for satellite in sorted(NAV.ephemerides)]
    for after_s in (0.0, 1800.0):
        seen = orbits.predict(sets, START.plus(after_s), PLACE, np.zeros(3))
        for k, ephemeris in enumerate(sets):
            path = travel(orbit_of(ephemeris, START), np.array([after_s]), PLACE[None])
            assert path.range_m[0] == pytest.approx(seen.sight.range_m[k], abs=1e-4)
            assert path.satellite_clock_s[0] == pytest.approx(seen.clock_s[k], abs=1e-15)


def test_real_orbits_agree_too(shared_data: Path) -> None:
    nav = read_nav(shared_data / "real/nav/tarc1030.23b")
    for satellite, sets in nav.ephemerides.items():
        e = sets[0]
        at = e.toe.plus(900.0)
        seen = orbits.predict([e], at, PLACE, np.zeros(3))
        path = travel(orbit_of(e, e.toe), np.array([900.0]), PLACE[None])
        assert path.range_m[0] == pytest.approx(seen.sight.range_m[0], abs=1e-4), satellite
        assert path.satellite_clock_s[0] == pytest.approx(seen.clock_s[0], abs=1e-15)


def test_ionosphere_agrees_with_the_receivers() -> None:
    random = np.random.default_rng(2)
    lat, lon = random.uniform(-1.2, 1.2, 200), random.uniform(-3.1, 3.1, 200)
    azimuth, elevation = random.uniform(0, 6.28, 200), random.uniform(0.05, 1.57, 200)
    tow_s = random.uniform(0.0, 604_800.0, 200)
    got = ionosphere_of(NAV.klobuchar, BDS_B1I, lat, lon, azimuth, elevation, tow_s)
    for k in range(200):
        seen = azimuth[k : k + 1], elevation[k : k + 1], float(tow_s[k])
        wanted = atmosphere.beidou_klobuchar_delay(BEIDOU_KLOBUCHAR, lat[k], lon[k], *seen)
        assert got[k] == pytest.approx(wanted[0], rel=1e-9)
    gps = ionosphere_of({"G": KLOBUCHAR}, BDS_B1I, lat, lon, azimuth, elevation, tow_s)
    assert 1.0 < np.median(got) < 15.0
    assert np.abs(gps - got).max() > 0.1


# --- constellation -------------------------------------------------------------------------------


def test_constellation_is_the_one_of_the_interface_document() -> None:
    beidou = {name: sets for name, sets in NAV.ephemerides.items() if name[0] == "C"}
    assert len(beidou) == 5 + 8 + 24
    assert NAV.klobuchar == {"G": KLOBUCHAR, "C": BEIDOU_KLOBUCHAR}
    for satellite, (ephemeris,) in beidou.items():
        assert ephemeris.toe.plus(-14.0).tow_s % 3600.0 == 0.0
        assert 0.0 <= START.since(ephemeris.transmitted) < 3600.0
        axis_m = ephemeris.sqrt_a_rm**2
        medium = int(satellite[1:]) >= 19
        assert axis_m == pytest.approx(27_906_100.0 if medium else 42_164_170.0, abs=300.0)
    with pytest.raises(ConfigError, match="systems: 'GE'"):
        nominal(START, 60.0, "GE")
    assert nominal(START, 60.0).ephemerides.keys() == {n for n in NAV.ephemerides if n[0] == "G"}


def places(satellite: str, hours: range) -> np.ndarray:
    """ECEF positions, hour by hour, each from the set of its hour."""
    nav = nominal(GpsTime(2290, 14.0), hours.stop * 3600.0, "C")
    sets = [nav.ephemerides[satellite][hour] for hour in hours]
    return np.array([orbits.satellite_states([e], e.toe, np.zeros(1)).r_e_m[0] for e in sets])


@pytest.mark.parametrize(
    ("satellite", "east_deg"),
    [("C01", 140.0), ("C02", 80.0), ("C03", 110.5), ("C04", 160.0), ("C05", 58.75)],
)
def test_geostationary_satellites_stay_at_their_longitudes(satellite: str, east_deg: float) -> None:
    x, y, z = places(satellite, range(26)).T
    longitude_deg = np.degrees(np.arctan2(y, x))
    latitude_deg = np.degrees(np.arctan2(z, np.hypot(x, y)))
    assert np.abs(longitude_deg - east_deg).max() < 0.15
    assert 0.7 < latitude_deg.max() < 1.9
    assert -1.9 < latitude_deg.min() < -0.7


def test_inclined_satellites_fly_figures_of_eight() -> None:
    for satellite, east_deg in (("C06", 118.0), ("C07", 118.0), ("C10", 95.0), ("C13", 112.0)):
        x, y, z = places(satellite, range(25)).T
        longitude_deg = np.degrees(np.arctan2(y, x))
        assert longitude_deg.mean() == pytest.approx(east_deg, abs=3.0)
        assert np.ptp(longitude_deg) < 50.0
        assert np.degrees(np.arctan2(z, np.hypot(x, y))).max() == pytest.approx(55.0, abs=2.0)


@pytest.mark.parametrize("week", [2190, 2290, 2400])
def test_successive_sets_describe_one_orbit(week: int) -> None:
    """Within the last bits of the message, also across the end of the week."""
    nav = nominal(GpsTime(week, 600_000.0), 8000.0, "C")
    for sets in nav.ephemerides.values():
        for before, after in itertools.pairwise(sets):
            middle = before.toe.plus(1800.0)
            states = [orbits.satellite_states([e], middle, np.zeros(1)) for e in (before, after)]
            assert np.linalg.norm(states[0].r_e_m - states[1].r_e_m) < 0.25
            assert np.linalg.norm(states[0].v_e_mps - states[1].v_e_mps) < 1e-4


def test_nav_file_holds_the_constellation(tmp_path: Path) -> None:
    path = tmp_path / "n.rnx"
    write_nav(path, NAV)
    again = read_nav(path)
    assert again.ephemerides.keys() == NAV.ephemerides.keys()
    for satellite, (wanted,) in NAV.ephemerides.items():
        (got,) = again.ephemerides[satellite]
        assert (got.toe, got.toc, got.transmitted) == (wanted.toe, wanted.toc, wanted.transmitted)
        assert got.group_delay2_s == pytest.approx(wanted.group_delay2_s, abs=1e-20)
        assert got.m0_rad == pytest.approx(wanted.m0_rad, abs=1e-11)
        assert (got.iode, got.iodc, got.health) == (wanted.iode, wanted.iodc, wanted.health)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of xarray, about defaults to come
        theirs = georinex.load(path, use={"C"})
    assert len(theirs.sv) == 37
    row = theirs.sel(sv="C03").squeeze()
    assert float(row["TGD1"]) == pytest.approx(one_of("C03").group_delay_s)
    assert float(row["BDTWeek"]) == 2290 - 1356
    assert float(row["Toe"]) == one_of("C03").toe.plus(-14.0).tow_s


# --- messages ------------------------------------------------------------------------------------


def test_broadcast_gives_back_the_true_orbit_to_the_last_bit() -> None:
    start = GpsTime(2290, 382_274.0)
    for satellite in (name for name in NAV.ephemerides if name[0] == "C"):
        wanted, geo = one_of(satellite), int(satellite[1:]) <= 5
        message, encode, step_s = (D2, encode_d2, 0.6) if geo else (D1, encode_d1, 6.0)
        state = message.start(satellite)
        for k in range(50 if geo else 5):
            bits = encode(start.plus(step_s * k), wanted, BEIDOU_KLOBUCHAR, NAV.utc)
            (frame,) = message.find_frames(bits, 0)
            state, _ = message.collect(state, frame.subframe, None)
        for name in Ephemeris.__dataclass_fields__:
            if name != "transmitted":
                assert getattr(state.ephemeris, name) == getattr(wanted, name), (satellite, name)
        assert state.klobuchar == BEIDOU_KLOBUCHAR


def frames_of(signal: Signal, sent: Symbols) -> list[tuple[float, int]]:
    """Time told by every frame that is there, and the index of its first symbol."""
    bits = ((1 - sent.values) // 2).astype(np.int8)
    frames = signal.message.find_frames(bits, 0)
    return [(frame.start_tow_s, frame.first) for frame in frames if frame.confirmed]


@pytest.mark.parametrize("start", [START, END_OF_WEEK, GpsTime(2290, 3.7), GpsTime(2290, 14.0)])
@pytest.mark.parametrize("satellite", ["G07", "C03", "C21"])
def test_symbols_leave_at_the_time_they_tell(satellite: str, start: GpsTime) -> None:
    """For any start, within a frame and across the ends of the weeks of GPST and BDT."""
    signal = of_satellite(satellite)
    nav = nominal(start, 40.0, satellite[0])
    sent = sent_symbols(signal, nav, one_of(satellite, nav), start, 40.0)
    first_s, end_s = (
        sent.first * signal.symbol_s,
        (sent.first + sent.values.size) * signal.symbol_s,
    )
    assert first_s <= start.tow_s - 0.2
    assert end_s >= start.tow_s + 40.2
    found = frames_of(signal, sent)
    assert len(found) == sent.values.size // 300
    for tow_s, first in found:
        left_s = (sent.first + first) * signal.symbol_s
        assert (tow_s - left_s) % 604_800.0 == pytest.approx(0.0, abs=1e-6) or (
            left_s - tow_s
        ) % 604_800.0 == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("satellite", ["G07", "C03", "C21"])
def test_the_message_changes_with_the_set_in_force(satellite: str) -> None:
    """Just before the full hour or two, by the satellite's system, the old set, then the new."""
    late_s = 14.0 if satellite[0] == "C" else 0.0
    change = GpsTime(2290, 8 * 7200.0 + late_s)
    start = change.plus(-75.0)
    nav, signal = nominal(start, 150.0, satellite[0]), of_satellite(satellite)
    old, new = nav.ephemerides[satellite]
    assert new.transmitted == change
    for truth in (old, new):  # whichever is flown
        sent = sent_symbols(signal, nav, truth, start, 150.0)
        bits = ((1 - sent.values) // 2).astype(np.int8)
        state, told = signal.message.start(satellite), []
        for frame in signal.message.find_frames(bits, 0):
            state, news = signal.message.collect(state, frame.subframe, start)
            told += [(frame.start_tow_s, n.m0_rad) for n in news if isinstance(n, Ephemeris)]
        assert [m0 for _, m0 in told] == [old.m0_rad, new.m0_rad]
        assert change.tow_s <= told[1][0] <= change.tow_s + 30.0


def test_ionosphere_and_utc_are_in_the_message() -> None:
    for satellite, seconds in (("C21", 720.0), ("C03", 360.0)):
        signal = of_satellite(satellite)
        sent = sent_symbols(signal, NAV, one_of(satellite), START, seconds)
        bits = ((1 - sent.values) // 2).astype(np.int8)
        state, told = signal.message.start(satellite), []
        for frame in signal.message.find_frames(bits, 0):
            state, news = signal.message.collect(state, frame.subframe, START)
            told += [new for new in news if isinstance(new, IonoUtc)]
        assert told[0] == IonoUtc(BEIDOU_KLOBUCHAR, None, "C")
        utc = next(new.utc for new in told if new.utc is not None)
        assert NAV.utc is not None
        assert (utc.leap_s, utc.leap_future_s) == (18, 18)
        assert (utc.leap_week, utc.leap_day) == (NAV.utc.leap_week, NAV.utc.leap_day)
        assert (utc.a0_s, utc.a1_sps) == (NAV.utc.a0_s, NAV.utc.a1_sps)


# --- samples -------------------------------------------------------------------------------------


@pytest.mark.parametrize("satellite", ["C01", "C06", "C05", "C22"])
def test_samples_carry_code_nh_code_and_symbols(satellite: str) -> None:
    """A code period after the other, despread by the truth: phase as told, signs as sent."""
    rate_hz, periods = 5.0e6, 60
    signal, start = of_satellite(satellite), GpsTime(2290, 382_256.25)
    place = Vehicle(0.6, 1.75, 50.0, Static())
    front_end = FrontEnd(rate_hz, format="float32", centre_hz=BDS_B1I.carrier_hz)
    emitter = Emitter(satellite, ((0.0, 50.0),), signal)
    scenario = Scenario(
        "b1i", start, 2.0, place, (emitter,), NAV, (Stream("B1", front_end),),
        clock=ReceiverClock(), noise=False,
    )  # fmt: skip
    source = sample_source(scenario)
    first, count = 1_000_000, round(rate_hz * 1e-3)
    values = source(first, (periods + 2) * count).astype(np.float64)
    wave = values[0] + 1j * values[1]
    t_s = (first + np.arange(wave.size)) / rate_hz
    knots = np.linspace(t_s[0], t_s[-1], 200)
    truth = receive(scenario, emitter, orbit_of(scenario.orbit_set(satellite), start), knots)
    sent_s = t_s - np.interp(t_s, knots, truth.pseudorange_m) / SPEED_OF_LIGHT_MPS
    cycles = -np.interp(t_s, knots, truth.carrier_cycles)
    chips = np.floor((start.tow_s + sent_s) * 2.046e6).astype(np.int64)
    local = b1i_code(emitter.prn)[chips % 2046] * np.exp(-2j * np.pi * np.mod(cycles, 1.0))
    period = chips // 2046
    numbers = np.arange(period[0] + 1, period[0] + 1 + periods)
    sums = np.array([np.mean((wave * local)[period == number]) for number in numbers])
    level = np.sqrt(2.0 * 10.0**5.0 / rate_hz)
    np.testing.assert_allclose(np.abs(sums), level, rtol=0.01)
    sent = sent_symbols(signal, NAV, scenario.orbit_set(satellite), start, 2.0)
    signs = sent.values[numbers // signal.symbol_periods - sent.first].astype(np.float64)
    if signal is BDS_B1I_D1:
        signs *= np.array(NH20)[numbers % 20]
    np.testing.assert_allclose(sums.real, level * signs, atol=0.02 * level)
    assert np.ptp(signs) == 2.0
    assert signal is (BDS_B1I_D2 if emitter.prn <= 5 else BDS_B1I_D1)
