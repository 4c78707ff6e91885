"""What the receiver concludes from its channels: time, copies, hand-over from prediction."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from simulated_sky import (
    BLOCKED_1_S,
    CARRIER_HZ,
    CHIP_HZ,
    STEADY_DBHZ,
    Sky,
    shared_sky,
    start_channel,
)

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.records import GPS_L1CA, Event, NavData, Observation
from deepgnss.core.time import GpsTime
from deepgnss.io.rinex_obs import ObsHeader, RinexObsWriter
from deepgnss.receiver import lnav
from deepgnss.receiver.acquisition import AcquisitionSettings
from deepgnss.receiver.bank import Head
from deepgnss.receiver.clock import NS, ReceiverClock, to_ns
from deepgnss.receiver.feed import SumFeed
from deepgnss.receiver.locks import LockState
from deepgnss.receiver.measured import Measured
from deepgnss.receiver.modes import AidingRate, AidingSource, Coast, Mode, TrackingSettings
from deepgnss.receiver.receiver import Knowledge, Receiver, ReceiverSettings
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL

RATE_HZ = 2.6e6
SETTINGS = ReceiverSettings(output_ns=NS // 10)


def _true_clock() -> ReceiverClock:
    scenario = shared_sky().scenario
    drift_sps = scenario.clock.drift_sps
    return ReceiverClock(
        Fraction(RATE_HZ), to_ns(scenario.start), scenario.clock.offset_s, drift_sps, drift_sps
    )


def _feed() -> SumFeed:
    sky = shared_sky()
    return SumFeed(lambda f, n: sky.read("L1", f, n), sky.stream, CARRIER_HZ, 0)


def _receiver(knowledge: Knowledge) -> Receiver:
    return Receiver([(GPS_L1CA_SIGNAL, RATE_HZ)], SETTINGS, knowledge)


# --- hand-over -----------------------------------------------------------------------------------


def test_with_time_place_and_orbits_the_first_epoch_knows_all() -> None:
    """Channels start with transmit time and symbol edges, no frame has been seen."""
    sky = shared_sky()
    place_e_m = sky.scenario.vehicle.point(np.zeros(1)).r_m[0]
    knowledge = Knowledge(sky.scenario.nav, sky.scenario.start, _true_clock(), place_e_m + 500.0)
    receiver = _receiver(knowledge)
    receiver.step({"GPS_L1CA": _feed()}, 0, 260_000)
    found = {channel.satellite: channel for channel in receiver.channels}
    strong = [e.satellite for e in sky.scenario.emitters if e.cn0_dbhz[0][1] > 33.0]
    assert set(strong) <= set(found)
    assert set(found) <= {e.satellite for e in sky.scenario.emitters}
    for satellite, channel in found.items():
        command = channel.command
        truth = sky.truth(satellite, np.array([command.sample]))
        assert channel.anchor is not None
        sent_s = (channel.anchor + channel.periods) * 1e-3 % SECONDS_PER_WEEK - truth.whole_s
        assert sent_s + command.code_chips / 1.023e6 == pytest.approx(truth.sent_s[0], abs=3e-7)
        assert channel.edge is not None
        assert (channel.anchor + channel.edge) % 20 == 0


@pytest.mark.parametrize(("shift", "told"), [(0, True), (1, False)])
def test_a_channel_too_weak_to_be_read_gets_its_time_by_prediction(shift: int, told: bool) -> None:
    """Where its symbol edges are those predicted."""
    sky = shared_sky()
    place_e_m = sky.scenario.vehicle.point(np.zeros(1)).r_m[0]
    knowledge = Knowledge(sky.scenario.nav, sky.scenario.start, _true_clock(), place_e_m)
    receiver = _receiver(knowledge)
    feed = _feed()
    for k in range(4):
        receiver.step({"GPS_L1CA": feed}, k * 260_000, (k + 1) * 260_000)
    channel = receiver.channels[0]
    anchor, channel.anchor, channel.mode = channel.anchor, None, Mode.WEAK
    assert anchor is not None
    assert channel.edge is not None
    channel.edge += shift
    place = receiver._place(4 * 260_000)
    assert place is not None
    assert receiver.clock is not None
    events = receiver.banks[0].anchor_faint(place, receiver.nav, receiver.clock, 4 * 260_000)
    assert [event.satellite for event in events] == [channel.satellite] * told
    assert channel.anchor == (anchor if told else None)


def test_a_screened_range_leaves_the_position_and_stays_observed() -> None:
    """The screen is asked once a tag, before its position; its reason stands in the solution."""
    sky = shared_sky()
    place_e_m = sky.scenario.vehicle.point(np.zeros(1)).r_m[0]
    knowledge = Knowledge(sky.scenario.nav, sky.scenario.start, _true_clock(), place_e_m)
    receiver, feed, asked = _receiver(knowledge), {"GPS_L1CA": _feed()}, []

    def screen(measured: Measured) -> dict[str, str]:
        asked.append(measured.epoch.time)
        return {measured.epoch.observations[0].satellite: "range 12.0 m off"}

    fixes = [
        fix
        for k in range(12)
        for fix in receiver.step(feed, k * 260_000, (k + 1) * 260_000, screen=screen).fixes
    ]
    assert [fix.epoch.time for fix in fixes] == asked
    assert any(fix.solution.valid for fix in fixes)
    for fix in fixes:
        satellite = fix.epoch.observations[0].satellite
        assert fix.solution.rejected[satellite] == "range 12.0 m off"
        assert satellite not in fix.solution.used
    wide = {c.satellite: c.report("").code_bandwidth_hz for c in receiver.channels}
    doubted = fixes[-1].epoch.observations[0].satellite
    assert wide.pop(doubted) == 3.0  # no average of what is wrong
    assert all(wide[one.satellite] < 3.0 for one in fixes[0].epoch.observations[1:])


@pytest.mark.parametrize("cn0_dbhz", STEADY_DBHZ[:6])
def test_cold_search_starts_channels_near_the_truth(cn0_dbhz: float) -> None:
    """Within what pull-in bears: a quarter of a chip and 10 Hz."""
    sky, receiver = shared_sky(), _cold()
    satellite = next(e.satellite for e in sky.scenario.emitters if e.cn0_dbhz[0][1] == cn0_dbhz)
    assert satellite in receiver
    code_chips, doppler_hz = receiver[satellite]
    truth = sky.truth(satellite, np.array([0, 26_000]))
    off = (code_chips - truth.code_chips[0] + 511.5) % 1023 - 511.5
    assert abs(off) < 0.25
    true_hz = (truth.carrier_cycles[1] - truth.carrier_cycles[0]) * 100.0
    assert doppler_hz == pytest.approx(true_hz, abs=10.0)


_found: dict[str, tuple[float, float]] = {}


def _cold() -> dict[str, tuple[float, float]]:
    if not _found:
        from deepgnss.receiver.acquisition import cold_search

        sums = _feed().over(0, int(0.03 * RATE_HZ))
        for seen in cold_search(sums, 0, GPS_L1CA_SIGNAL, AcquisitionSettings()):
            if seen.found:
                _found[seen.satellite] = (seen.code_chips, seen.doppler_hz)
    return _found


# --- time ----------------------------------------------------------------------------------------


def _with_channel(receiver: Receiver, satellite: str, symbols_first: int = 300) -> None:
    channel = start_channel(shared_sky(), satellite, TrackingSettings())
    channel.mode = Mode.PHASE
    channel.stream.resume(bytearray(), symbols_first)
    receiver.banks[0].channels[int(satellite[1:])] = channel


def _head(receiver: Receiver, prn: int, start_tow_s: int, first: int, confirmed: bool) -> Head:
    channel = receiver.banks[0].channels[prn]
    frame = lnav.Frame(first, 1, start_tow_s, 1, confirmed, None)
    return Head(channel, channel.symbols_first, frame)


def _two_or_more(count: int, near: GpsTime, confirmed: bool = False) -> Receiver:
    receiver = _receiver(Knowledge(near=near))
    for emitter in shared_sky().scenario.emitters[:count]:
        _with_channel(receiver, emitter.satellite)
        receiver.banks[0].heads[emitter.prn] = _head(receiver, emitter.prn, 382_260, 10, confirmed)
    receiver._take_heads()
    return receiver


@pytest.mark.parametrize(("count", "confirmed", "believed"), [
    (1, False, False), (2, False, False), (3, False, True), (1, True, True),
])  # fmt: skip
def test_heads_are_believed_when_confirmed_or_seen_by_three(
    count: int, confirmed: bool, believed: bool
) -> None:
    receiver = _two_or_more(count, GpsTime(2290, 300_000.0), confirmed)
    assert (receiver.clock is not None) == believed
    for channel in receiver.channels:
        assert (channel.anchor is not None) == believed
        assert channel.half_cycle == (0.5 if believed else None)
    if believed:
        assert receiver.clock is not None
        anchor = (2290 * SECONDS_PER_WEEK + 382_260) * 1000 - 300 - 200
        assert {channel.anchor for channel in receiver.channels} == {anchor}


@pytest.mark.parametrize(
    ("near", "start_tow_s", "week"),
    [
        (GpsTime(2290, 604_790.0), 0, 2291),
        (GpsTime(2290, 604_799.9999999), 0, 2291),
        (GpsTime(2291, 1e-9), 0, 2291),
        (GpsTime(2290, 604_790.0), 604_794, 2290),
        (GpsTime(2291, 5.0), 604_794, 2290),
        (GpsTime(2291, 5.0), 6, 2291),
    ],
)
def test_week_of_a_frame_near_the_week_s_end(near: GpsTime, start_tow_s: int, week: int) -> None:
    receiver = _receiver(Knowledge(near=near))
    satellite = shared_sky().scenario.emitters[0].satellite
    _with_channel(receiver, satellite)
    prn = int(satellite[1:])
    receiver.banks[0].heads[prn] = _head(receiver, prn, start_tow_s, 0, True)
    receiver._take_heads()
    channel = receiver.banks[0].channels[prn]
    assert channel.anchor == (week * SECONDS_PER_WEEK + start_tow_s) * 1000 - 300


def test_a_head_of_an_earlier_lock_is_forgotten() -> None:
    """Its place counts from symbols that are gone: taken now, time would be wrong."""
    receiver = _receiver(Knowledge(near=GpsTime(2290, 300_000.0)))
    for emitter in shared_sky().scenario.emitters[:3]:
        _with_channel(receiver, emitter.satellite)
        receiver.banks[0].heads[emitter.prn] = _head(receiver, emitter.prn, 382_260, 10, False)
    for channel in receiver.channels:
        channel.stream.first += 20  # locked again a symbol later
    receiver._take_heads()
    assert receiver.clock is None
    assert not receiver.banks[0].heads


def test_clock_from_heads_is_good_to_the_travel_time() -> None:
    receiver = _two_or_more(3, GpsTime(2290, 300_000.0))
    assert receiver.clock is not None
    channel = receiver.channels[0]
    assert channel.anchor is not None
    sent_s = (channel.anchor + channel.periods) * 1e-3
    travel_s = receiver.clock.origin_ns / NS + channel.command.sample / RATE_HZ - sent_s
    assert travel_s == pytest.approx(0.075, abs=1e-3)
    assert receiver.clock.uncertainty_s > 0.01


# --- copies --------------------------------------------------------------------------------------


def _strength(cn0_dbhz: float) -> LockState:
    """Averages as of a signal of this strength."""
    snr = 10.0 ** (0.1 * cn0_dbhz) * 1e-3
    return LockState(1.0, snr, snr, (snr,), 1.0, 1.0, 1.0, 1.0 + 0j)


@pytest.mark.parametrize("copy_tells_first", [False, True])
def test_the_weaker_of_two_that_tell_the_same_orbit_is_dropped(copy_tells_first: bool) -> None:
    strong, weak = (e.satellite for e in shared_sky().scenario.emitters[:2])
    orbit = shared_sky().scenario.nav.ephemerides[strong][0]
    receiver = _receiver(Knowledge())
    for satellite, cn0_dbhz in ((strong, 50.0), (weak, 29.0)):
        _with_channel(receiver, satellite)
        receiver.banks[0].channels[int(satellite[1:])].locks = _strength(cn0_dbhz)
    first, second = (weak, strong) if copy_tells_first else (strong, weak)
    told = replace(orbit, satellite=first)
    receiver.nav = NavData(ephemerides={first: (told,)})
    channel = receiver.banks[0].channels[int(second[1:])]
    is_copy = receiver._is_copy(receiver.banks[0], channel, replace(orbit, satellite=second))
    assert is_copy == (not copy_tells_first)
    assert receiver.banks[0].channels[int(weak[1:])].mode is Mode.LOST
    assert receiver.banks[0].channels[int(strong[1:])].mode is Mode.PHASE
    assert weak not in receiver.nav.ephemerides
    assert [(e.satellite, e.what) for e in receiver._events] == [(weak, "lost")]
    assert f"sends the orbit of {strong}" in receiver._events[0].reason


def test_a_satellite_s_own_next_set_is_no_copy() -> None:
    satellite = shared_sky().scenario.emitters[0].satellite
    orbit = shared_sky().scenario.nav.ephemerides[satellite][0]
    receiver = _receiver(Knowledge(nav=shared_sky().scenario.nav))
    _with_channel(receiver, satellite)
    assert not receiver._is_copy(
        receiver.banks[0], receiver.banks[0].channels[int(satellite[1:])], orbit
    )


# --- open loop -----------------------------------------------------------------------------------


def _truly(sky: Sky, satellite: str) -> AidingSource:
    """Aiding without errors, the receiver's clock in its own place."""
    clock_hz = -sky.scenario.clock.drift_sps * CARRIER_HZ

    def at(sample: int) -> AidingRate:
        samples = sample + 0.02 * RATE_HZ * np.arange(3)
        cycles = sky.truth(satellite, samples).carrier_cycles
        first, second = np.diff(cycles) / 0.02
        rate_hzps = (second - first) / 0.02
        return AidingRate(first - 0.01 * rate_hzps - clock_hz, rate_hzps, clock_hz)

    return at


def _one_blocked(sky: Sky) -> tuple[str, Receiver]:
    """The satellite that is blocked for a second, and a receiver told time, place and orbits."""
    satellite = next(e.satellite for e in sky.scenario.emitters if e.cn0_dbhz == BLOCKED_1_S)
    place_e_m = sky.scenario.vehicle.point(np.zeros(1)).r_m[0]
    knowledge = Knowledge(sky.scenario.nav, sky.scenario.start, _true_clock(), place_e_m)
    return satellite, _receiver(knowledge)


def test_channels_in_open_loop_are_told_apart_and_can_be_put_right() -> None:
    sky = shared_sky()
    satellite, receiver = _one_blocked(sky)
    feed, aiding = _feed(), {satellite: _truly(sky, satellite)}
    coasted: list[tuple[float, Observation, bool]] = []
    received: list[tuple[float, Observation]] = []
    moved = False
    for k in range(66):
        result = receiver.step({"GPS_L1CA": feed}, k * 260_000, (k + 1) * 260_000, aiding)
        for fix in result.fixes:
            at = fix.epoch.instant
            sample = at.sample + at.fraction
            assert {o.satellite for o in fix.coasting} <= {satellite}
            coasted += [(sample, o, moved) for o in fix.coasting]
            here = [o for o in fix.epoch.observations if o.satellite == satellite]
            received += [(sample, o) for o in here]
            assert not (here and fix.coasting)
            assert here or satellite not in fix.solution.used
        if coasted and coasted[-1][0] > 4.55 * RATE_HZ and not moved:
            moved = True
            receiver.coast({satellite: Coast(154.0, 0.1)})
    samples = np.array([sample for sample, _, _ in coasted])
    assert 4.0 * RATE_HZ < samples[0] < 4.35 * RATE_HZ
    assert 4.95 * RATE_HZ < samples[-1] < 5.3 * RATE_HZ
    assert np.all(np.abs(np.diff(samples) - 0.1 * RATE_HZ) < 1.0)
    truth = sky.truth(satellite, samples)
    told_s = np.array([o.transmit.tow_s for _, o, _ in coasted])
    late_chips = (truth.whole_s + truth.sent_s - told_s) * CHIP_HZ
    shifted = np.array([moved for _, _, moved in coasted])
    assert late_chips[shifted] - late_chips[0] == pytest.approx(0.1, abs=0.02)
    assert late_chips[~shifted] - late_chips[0] == pytest.approx(0.0, abs=0.02)
    before = [o.arc for sample, o in received if sample < samples[0] and o.carrier_valid]
    after = [o.arc for sample, o in received if sample > samples[-1] and o.carrier_valid]
    assert before
    assert after
    assert not set(before) & set(after)


def test_a_channel_let_go_is_lost_with_its_reason_and_searched_anew() -> None:
    sky = shared_sky()
    satellite, receiver = _one_blocked(sky)
    feed, aiding = _feed(), {satellite: _truly(sky, satellite)}
    events: list[Event] = []
    let_go = False
    for k in range(64):
        result = receiver.step({"GPS_L1CA": feed}, k * 260_000, (k + 1) * 260_000, aiding)
        events += [event for event in result.events if event.satellite == satellite]
        if not let_go and any(fix.coasting for fix in result.fixes):
            let_go = True
            receiver.let_go({satellite: "too far off"})
            assert satellite not in {channel.satellite for channel in receiver.channels}
    ends = [k for k, event in enumerate(events) if event.what == "lost"]
    assert [events[k].reason for k in ends] == ["too far off"]
    assert "acquired" in [event.what for event in events[ends[0] :]]  # blocked for a second only


@pytest.mark.parametrize("bridged", [True, False])
def test_a_phase_carried_through_shows_no_slip_in_rinex(bridged: bool, tmp_path: Path) -> None:
    sky = shared_sky()
    satellite, receiver = _one_blocked(sky)
    feed, aiding = _feed(), {satellite: _truly(sky, satellite)}
    writer = RinexObsWriter(tmp_path, ObsHeader([GPS_L1CA], 0.1, 7.0, name="test.obs"))
    off_cycles: dict[float, float] = {}
    for k in range(70):
        result = receiver.step({"GPS_L1CA": feed}, k * 260_000, (k + 1) * 260_000, aiding)
        if bridged:
            coasting = [o for fix in result.fixes for o in fix.coasting]
            receiver.coast({o.satellite: Coast(0.0, 0.02) for o in coasting})
        for fix in result.fixes:
            if fix.output:
                writer.write(fix.epoch)
            for seen in fix.epoch.observations:
                if seen.satellite == satellite and seen.carrier_valid:
                    instant = fix.epoch.instant
                    sample = np.array([instant.sample + instant.fraction])
                    truth = sky.truth(satellite, sample).carrier_cycles[0]
                    lag_s = _true_clock().lag_s(to_ns(fix.epoch.time), instant)
                    off = seen.carrier_cycles - CARRIER_HZ * lag_s + truth
                    off_cycles[sample[0] / RATE_HZ] = off
    with writer:
        pass
    lines = [x for x in (tmp_path / "test.obs").read_text().splitlines() if x[:3] == satellite]
    phases = [line[19:35] for line in lines if line[19:33].strip()]
    gap = next(k for k, t in enumerate(sorted(off_cycles)) if t > 4.5)
    assert [phase[14] in "13" for phase in phases] == [
        k == 0 or (k == gap and not bridged) for k in range(len(phases))
    ]
    if bridged:
        off = np.array([off_cycles[t] for t in sorted(off_cycles)])
        assert np.abs(off - np.median(off)).max() < 0.06
        assert sorted(off_cycles)[gap] < 5.45


def test_arcs_of_a_satellite_found_again_are_new_ones() -> None:
    receiver = _receiver(Knowledge())
    satellite = shared_sky().scenario.emitters[0].satellite
    _with_channel(receiver, satellite)
    bank, prn = receiver.banks[0], int(satellite[1:])
    channel = bank.channels[prn]
    channel.slips = 7
    channel.drop("test")
    assert bank.retire() == [channel]
    bank._take(bank._as_seen(channel, prn, 1000), 1000, None, None)
    assert bank.channels[prn].slips == 8
