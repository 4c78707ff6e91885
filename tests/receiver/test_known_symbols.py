"""Symbols told before they come, against what the satellite then sends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deepgnss.core.constants import SECONDS_PER_WEEK
from deepgnss.core.time import GpsTime
from deepgnss.receiver.acquisition import AcquisitionSettings
from deepgnss.receiver.bank import Bank
from deepgnss.receiver.channel import Channel
from deepgnss.receiver.known_symbols import KnownSymbols, Sent, foretold, remembered, signs
from deepgnss.receiver.messages import MessageFormat
from deepgnss.receiver.modes import Mode, TrackingSettings
from deepgnss.receiver.search import SearchSettings
from deepgnss.receiver.signals import BDS_B1I_D1, BDS_B1I_D2, GPS_L1CA_SIGNAL, Signal
from deepgnss.sim.constellation import nominal
from deepgnss.sim.navbits import sent_symbols

START = GpsTime(2290, 382_260.0)
NAV = nominal(START, 200.0, "GC")
SIZE_S = 6


def _bits(signal: Signal, satellite: str, from_s: float, seconds: float) -> np.ndarray:
    """Symbols 0/1 a satellite sends from a second after the start on."""
    start = START.plus(from_s)
    symbols = sent_symbols(signal, NAV, NAV.ephemerides[satellite][0], start, seconds)
    first = round(start.tow_s / signal.symbol_s) - symbols.first
    values = symbols.values[first : first + round(seconds / signal.symbol_s)]
    return (values < 0).astype(np.int8)


def _heard(signal: Signal, satellite: str, from_s: float, seconds: float) -> Sent:
    message, sent = signal.message, {}
    for frame in message.find_frames(_bits(signal, satellite, from_s, seconds), 0):
        if frame.subframe is not None:
            sent = remembered(sent, frame.subframe, message)
    return sent


def _period(at_s: float) -> int:
    time = START.plus(at_s)
    return round((time.week * SECONDS_PER_WEEK + time.tow_s) * 1000)


@pytest.mark.parametrize(
    ("signal", "satellite", "phase_s"),
    [(GPS_L1CA_SIGNAL, "G05", 0), (BDS_B1I_D1, "C19", 2)],
)
def test_the_next_frame_s_ephemeris_is_foretold_bit_for_bit(
    signal: Signal, satellite: str, phase_s: int
) -> None:
    sent = _heard(signal, satellite, 0.0, 50.0)
    found = 0
    for at_s in np.arange(60.0 + phase_s, 90.0 + phase_s, SIZE_S) + 1.7:
        told = foretold(sent, signal.message, _period(float(at_s)), 1000, 20)
        if told is None:  # almanac: it comes again in minutes
            continue
        begin_s = (told.first - _period(0.0)) / 1000.0
        assert begin_s == at_s - 1.7
        found += 1
        seconds = len(told.symbols) * signal.symbol_s
        truth = _bits(signal, satellite, begin_s, seconds)
        np.testing.assert_array_equal(np.frombuffer(told.symbols, dtype=np.int8), truth)
    assert found == 3


def test_nothing_is_foretold_of_what_was_not_heard_or_has_no_rule() -> None:
    message = GPS_L1CA_SIGNAL.message
    assert foretold({}, message, _period(61.0), 1000, 20) is None
    sent = _heard(GPS_L1CA_SIGNAL, "G05", 0.0, 50.0)
    no_rule: MessageFormat = replace(message, again=None)
    assert foretold(sent, no_rule, _period(61.0), 1000, 20) is None
    assert BDS_B1I_D2.message.again is None


def test_signs_of_symbols_and_their_ends() -> None:
    known = KnownSymbols(1000, bytes([0, 1, 1, 0]))
    assert signs(known, 1020, 2, 20) == pytest.approx([-1.0, -1.0])
    assert signs(known, 1020, 4, 20) is None
    assert signs(known, 980, 2, 20) is None


@pytest.mark.parametrize(
    ("signal", "satellite", "back_s"),  # in the first subframe of a frame
    [(GPS_L1CA_SIGNAL, "G05", 63.5), (BDS_B1I_D1, "C19", 75.5)],
)
@pytest.mark.parametrize("inverted", [0, 1])
def test_foretold_symbols_settle_a_half_cycle_and_the_next_head_has_the_last_word(
    signal: Signal, satellite: str, back_s: float, inverted: int
) -> None:
    """A phase that comes back within a subframe heard before waits for no head of another."""
    settings, prn = TrackingSettings(), int(satellite[1:])
    bank = Bank(signal, 4e6, settings, AcquisitionSettings(), SearchSettings(), {})
    channel = Channel(
        signal, prn, settings, sample_rate_hz=4e6, sample=0, code_chips=0.0, doppler_hz=0.0
    )
    bank.channels[prn] = channel
    bank._sent[prn] = _heard(signal, satellite, 0.0, 50.0)
    channel.mode, channel.anchor = Mode.PHASE, _period(back_s)
    symbols = _bits(signal, satellite, back_s, 1.0) ^ inverted
    for count, half_cycle in ((31, None), (32, 0.5 * inverted)):
        channel.nco.periods = count * signal.symbol_periods
        channel.stream.resume(bytearray(symbols[:count].tobytes()), 0)
        bank.foretell_symbols()
        bank.take_known_polarities()
        assert channel.half_cycle == half_cycle
    arc = channel.slips
    assert channel.unproven and arc == inverted  # ½ cycle put on is told as a slip
    channel.set_polarity(0.5 * inverted)
    assert not channel.unproven and channel.slips == arc
    channel.unproven = True
    channel.set_polarity(0.5 - 0.5 * inverted)
    assert channel.half_cycle == 0.5 - 0.5 * inverted and channel.slips == arc + 1


def test_symbols_of_another_message_settle_nothing() -> None:
    settings = TrackingSettings()
    bank = Bank(GPS_L1CA_SIGNAL, 4e6, settings, AcquisitionSettings(), SearchSettings(), {})
    channel = Channel(
        GPS_L1CA_SIGNAL, 5, settings, sample_rate_hz=4e6, sample=0, code_chips=0.0, doppler_hz=0.0
    )
    bank.channels[5], bank._sent[5] = channel, _heard(GPS_L1CA_SIGNAL, "G05", 0.0, 50.0)
    channel.mode, channel.anchor, channel.nco.periods = Mode.PHASE, _period(63.5), 1000
    channel.stream.resume(bytearray(_bits(GPS_L1CA_SIGNAL, "G07", 63.5, 1.0)), 0)
    bank.foretell_symbols()
    bank.take_known_polarities()
    assert channel.half_cycle is None


@pytest.mark.parametrize("inverted", [0, 1])
def test_symbols_before_a_phase_was_lost_tell_nothing_of_the_next(inverted: int) -> None:
    """Decoded by an earlier pass: the new phase waits for symbols of its own, or for foretold ones.

    The loop may come back on the other half cycle.
    """
    settings, size = TrackingSettings(), GPS_L1CA_SIGNAL.symbol_periods
    heard = _bits(GPS_L1CA_SIGNAL, "G05", 0.0, 50.0)
    decoded = KnownSymbols(_period(0.0), heard.tobytes())
    bank = Bank(
        GPS_L1CA_SIGNAL, 4e6, settings, AcquisitionSettings(), SearchSettings(), {"G05": decoded}
    )
    channel = Channel(
        GPS_L1CA_SIGNAL, 5, settings, sample_rate_hz=4e6, sample=0, code_chips=0.0, doppler_hz=0.0
    )
    bank.channels[5], bank._sent[5] = channel, _heard(GPS_L1CA_SIGNAL, "G05", 0.0, 50.0)
    channel.known, channel.edge = decoded, 0
    channel.mode, channel.anchor, channel.nco.periods = Mode.PHASE, _period(0.0), heard.size * size
    channel.stream.resume(bytearray(heard.tobytes()), 0)
    bank.take_known_polarities()
    assert channel.half_cycle == 0.0
    channel._go(Mode.HOLD, "gone")
    bank.take_known_polarities()
    assert channel.half_cycle is None
    channel.mode, channel.nco.periods = Mode.PHASE, 64 * 1000
    back = _bits(GPS_L1CA_SIGNAL, "G05", 63.0, 1.0) ^ inverted
    channel.stream.resume(bytearray(back.tobytes()), 63 * 1000)
    bank.foretell_symbols()
    bank.take_known_polarities()
    assert channel.half_cycle == 0.5 * inverted
