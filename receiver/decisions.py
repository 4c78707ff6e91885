"""When a channel changes what it is doing: by C/N0, lock detectors and aiding, T figures 5.2, 5.3.

Every rule of the state machine is here; the channel carries out what is decided.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, Protocol

from scipy.special import gammainccinv

from deepgnss.core.jit import compilable
from deepgnss.receiver.locks import (
    LockState,
    faint_before_dbhz,
    faint_cn0_dbhz,
    false_lock_side,
    fast_cn0_dbhz,
    recent_cn0_dbhz,
    surely_seen_dbhz,
)
from deepgnss.receiver.modes import Mode, TrackingSettings, lowest_frequency_lock_dbhz
from deepgnss.receiver.signals import Signal
from deepgnss.receiver.windows import Windows

_HYSTERESIS_DB = 2.0  # below the threshold of phase lock before it is given up
_RETURN_DB = 1.0  # above the threshold of frequency tracking: it is taken up again
_ABSENT_DB = 7.0  # below that threshold: nothing is there
_FAINT_S = 2.5  # of frequency tracking before its C/N0 is believed
_STRONG_DB = 10.0  # above the limit: a signal whose loss is seen by few intervals …
_STRONG_AIDED_DB = 6.0  # … and where an open loop bears to be begun in vain
_KEPT_DBHZ = 25.0  # strong neighbours' cross-correlation below it ends no phase carried on …
_KEPT_S = 30.0  # … for so long: it may be the satellite itself, faint
_RISING_INTERVALS = 10  # before which a signal must have been there to be a faint one
_RISING_S = 0.1  # of frequency tracking before a strong signal is believed …
_RISEN_DB = 3.0  # … that much above the threshold of phase lock
_HALF_DB = 3.0
_LOST = 0.4  # mean cos 2φ below which a phase is lost …
_SURE = 0.8  # … and above which it is believed
_BACK_INTERVALS = 3  # that must each show a signal …
_BACK_FALSE = math.exp(-6.0)  # … which noise does in one of so many


class Go(NamedTuple):
    """Change of mode."""

    mode: Mode
    reason: str


class Shift(NamedTuple):
    """A false lock is to be left."""

    off_hz: float


class Locked(NamedTuple):
    """The phase counts from here on."""

    reason: str


Verdict = Go | Shift | Locked | None


class Tracked(Protocol):
    """What of a channel the rules look at."""

    signal: Signal
    settings: TrackingSettings
    mode: Mode
    locks: LockState
    cn0_dbhz: float
    edge: int | None
    frequency_error_hz: float
    phase_valid: bool
    windows: Windows

    @property
    def periods(self) -> int:
        """Code periods it has gone through."""

    @property
    def seconds_in_mode(self) -> float:
        """Since the last change of mode, or what counts as one."""

    @property
    def aided(self) -> bool:
        """Whether predictions lead its generators."""

    @property
    def coasting(self) -> bool:
        """Whether it runs on by aiding alone."""

    @property
    def lock_s(self) -> float:
        """Time after which its phase lock is believed."""

    @property
    def wide_cn0_dbhz(self) -> float:
        """C/N0 in open loop, whatever the frequency is off."""

    @property
    def phase_kept(self) -> bool:
        """Whether it has a phase that was carried on."""


def decide(channel: Tracked, period_s: float) -> Verdict:
    """What to do after an interval: at most one thing."""
    settings = channel.settings
    here_s = channel.seconds_in_mode
    cn0 = channel.cn0_dbhz
    fast = fast_cn0_dbhz(channel.locks, period_s)
    weak = _weakest_dbhz(settings)
    recent = recent_cn0_dbhz(channel.locks, period_s)
    fast = lately_dbhz(cn0, fast, recent, weak + _margin_db(channel.aided))
    gone = fast < weak
    match channel.mode:
        case Mode.PULL_IN:
            return _pulling_in(channel, here_s, fast, gone)
        case Mode.FREQUENCY:
            return _frequency(channel, here_s, cn0, fast, gone)
        case Mode.PHASE:
            return _phase(channel, here_s, cn0, fast, gone)
        case Mode.WEAK:
            return _weak(channel, here_s, cn0)
        case Mode.HOLD:
            return _hold(channel, here_s, fast, gone, period_s)
    return None


class Calm(NamedTuple):
    """Limits of a phase in order, dB-Hz: within them there is nothing to decide."""

    weak: float  # the signal is gone …
    strong: float  # … which of a stronger one few intervals tell
    lowest: float  # too weak for the phase


def calm(settings: TrackingSettings, *, aided: bool) -> Calm:
    """Limits of the rules for phase lock."""
    weak = _weakest_dbhz(settings)
    return Calm(weak, weak + _margin_db(aided), settings.phase_threshold_dbhz - _HYSTERESIS_DB)


@compilable
def in_order(limits: Calm, cn0: float, fast: float, indicator: float, side: int) -> bool:
    """Whether the rules have nothing to say of a phase that counts, however long it does.

    fast: as `lately_dbhz` has it; side: of a false lock.
    """
    return (
        fast >= limits.weak
        and cn0 >= limits.lowest
        and indicator >= _LOST
        and (side == 0 or indicator <= _SURE)
    )


@compilable
def lately_dbhz(cn0: float, fast: float, recent: float, strong: float) -> float:
    """C/N0 that tells whether a signal is gone: of a strong one few intervals do."""
    return min(fast, recent) if cn0 > strong else fast


def _weakest_dbhz(settings: TrackingSettings) -> float:
    return max(
        settings.frequency_threshold_dbhz,
        lowest_frequency_lock_dbhz(settings.phase_threshold_dbhz),
    )


def _margin_db(aided: bool) -> float:
    return _STRONG_AIDED_DB if aided else _STRONG_DB


def _pulling_in(channel: Tracked, here_s: float, fast: float, gone: bool) -> Verdict:
    patience_s = channel.settings.pull_in_s
    if here_s >= patience_s and gone:
        return Go(Mode.LOST, f"no signal after acquisition: {fast:.1f} dB-Hz")
    if here_s >= patience_s and abs(channel.frequency_error_hz) < 5.0:
        return Go(Mode.FREQUENCY, f"frequency settled at {fast:.1f} dB-Hz")
    if here_s > 10.0 * patience_s:
        return Go(Mode.LOST, "frequency does not settle")
    return None


def _frequency(channel: Tracked, here_s: float, cn0: float, fast: float, gone: bool) -> Verdict:
    threshold = channel.settings.phase_threshold_dbhz
    if gone and here_s > 0.1:
        return Go(_refuge(channel, fast), f"C/N0 fell to {fast:.1f} dB-Hz")
    if channel.edge is None:
        return None
    if here_s > 1.0 and cn0 < threshold:
        return Go(Mode.WEAK, f"{cn0:.1f} dB-Hz, too weak for the phase")
    if (
        _at_symbol_edge(channel)
        and here_s > 0.1
        and abs(channel.frequency_error_hz) < 3.0
        and cn0 > threshold
    ):
        return Go(Mode.PHASE, f"symbol edges known, {cn0:.1f} dB-Hz")
    return None


def _phase(channel: Tracked, here_s: float, cn0: float, fast: float, gone: bool) -> Verdict:
    indicator = channel.locks.phase
    lowest = channel.settings.phase_threshold_dbhz - _HYSTERESIS_DB
    if gone:
        return Go(_refuge(channel, fast), f"C/N0 fell to {fast:.1f} dB-Hz")
    if here_s > 0.5 and cn0 < lowest:
        return Go(Mode.WEAK, f"C/N0 {cn0:.1f} dB-Hz, too weak for the phase")
    if here_s > 0.5 and indicator < _LOST:
        return Go(Mode.FREQUENCY, f"phase lock lost: mean cos 2φ {indicator:.2f}")
    if here_s > channel.lock_s and indicator > _SURE:
        side = false_lock_side(channel.locks)
        if side:
            return Shift(side * 0.5 / channel.signal.symbol_s)
        if not channel.phase_valid:
            return Locked(f"mean cos 2φ {indicator:.2f}")
    return None


def _weak(channel: Tracked, here_s: float, cn0: float) -> Verdict:
    settings, windows = channel.settings, channel.windows
    lowest = settings.frequency_threshold_dbhz
    if channel.aided and here_s > _RISING_S and _at_symbol_edge(channel):
        now = recent_cn0_dbhz(channel.locks, channel.signal.period_s, _BACK_INTERVALS)
        if now > settings.phase_threshold_dbhz + _RISEN_DB and _surely_back(channel):
            return Go(Mode.PHASE, f"rose to {now:.1f} dB-Hz")
    if windows.under_way:
        return None
    recent = faint_cn0_dbhz(channel.locks, channel.signal.period_s)
    if windows.off_hz:
        return Shift(windows.off_hz)
    if windows.suspicious:
        return None
    if here_s > 0.6 and recent < lowest - _ABSENT_DB:
        return Go(Mode.HOLD, f"C/N0 fell to {recent:.1f} dB-Hz")
    if here_s > _FAINT_S and cn0 < lowest:
        return Go(Mode.HOLD, f"C/N0 {cn0:.1f} dB-Hz, too weak for the frequency")
    if (
        here_s > 1.0
        and min(cn0, recent) > settings.phase_threshold_dbhz
        and _at_symbol_edge(channel)
    ):
        return Go(Mode.PHASE, f"strong enough for the phase, {cn0:.1f} dB-Hz")
    return None


def _hold(channel: Tracked, here_s: float, fast: float, gone: bool, period_s: float) -> Verdict:
    settings = channel.settings
    back = faint_cn0_dbhz(channel.locks, period_s)
    if channel.coasting and channel.edge is not None:
        now = recent_cn0_dbhz(channel.locks, period_s, _BACK_INTERVALS)
        if now > settings.phase_threshold_dbhz:
            if not _surely_back(channel):
                return None
            mode = Mode.PHASE if channel.phase_kept else Mode.FREQUENCY
            return Go(mode, f"signal back at {now:.1f} dB-Hz")
        wide = channel.wide_cn0_dbhz
        if wide > max(settings.phase_threshold_dbhz, now) + _RISEN_DB:
            return Go(Mode.FREQUENCY, f"signal back at {wide:.1f} dB-Hz, off in frequency")
    elif not gone and here_s > 0.1 and fast > settings.phase_threshold_dbhz:
        return Go(Mode.FREQUENCY, f"signal back at {fast:.1f} dB-Hz")
    least = max(
        settings.frequency_threshold_dbhz + _RETURN_DB,
        surely_seen_dbhz(channel.signal.symbol_periods, period_s),
        _KEPT_DBHZ if channel.phase_kept and here_s < _KEPT_S else -math.inf,
    )
    # A strong signal on its way back passes through every strength.
    before = faint_before_dbhz(channel.locks, period_s, _RISING_INTERVALS)
    if channel.edge is not None and here_s > 0.5 and back > least and before > least - _HALF_DB:
        return Go(Mode.WEAK, f"signal back at {back:.1f} dB-Hz")
    if here_s > (settings.open_loop_s if channel.coasting else settings.lost_after_s):
        return Go(Mode.LOST, f"no signal for {here_s:.1f} s")
    return None


def _surely_back(channel: Tracked) -> bool:
    """Whether each of the last intervals shows more than noise would."""
    locks, size = channel.locks, channel.signal.symbol_periods
    least = _least_signal(channel.signal.update_periods // size) * locks.noise / size
    latest = locks.recent[-_BACK_INTERVALS:]
    return len(latest) == _BACK_INTERVALS and min(latest) > least


@lru_cache(maxsize=8)
def _least_signal(symbols: int) -> float:
    """Mean power of symbols, less that of noise and in its units, that noise alone rarely has."""
    return float(gammainccinv(symbols, _BACK_FALSE)) / symbols - 1.0


def _refuge(channel: Tracked, fast_dbhz: float) -> Mode:
    """Where a channel goes whose signal fell below what phase or FLL need.

    A signal that falls to nothing passes through every strength too: an aided loop waits and sees.
    """
    if channel.aided and channel.edge is not None:
        return Mode.HOLD
    bearable = fast_dbhz > channel.settings.frequency_threshold_dbhz
    return Mode.WEAK if bearable and channel.edge is not None else Mode.HOLD


def _at_symbol_edge(channel: Tracked) -> bool:
    edge, size = channel.edge, channel.signal.symbol_periods
    return edge is not None and (channel.periods - edge) % size == 0
