"""A prediction that leads a channel's carrier: fed forward, so that no loop ever sees it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from deepgnss.core.jit import brief_kernel, compilable
from deepgnss.core.records import FloatArray
from deepgnss.receiver.modes import NO_AIDING, AidingRate, AidingSource, Mode, unaided
from deepgnss.receiver.trackers import NcoState

_FOLLOWING = (Mode.PHASE, Mode.WEAK)


class Grid(NamedTuple):
    """Even points at which a prediction has its cycles."""

    first: float  # sample of the first point
    step: float  # samples between points
    ahead: float  # points in what a command is taken as linear over …
    ahead_s: float  # … and its length


@brief_kernel
def predicted(
    first: float, step: float, ahead: float, ahead_s: float, cycles: FloatArray, sample: int
) -> tuple[float, float]:
    """Doppler at a sample and its slope over the update that begins there, by a `Grid`.

    The two make the cycles (n,) of both halves of the update: what shakes an inertial unit would
    not average out of single values. Linear between and beyond the points.
    """
    begin = (sample - first) / step
    start = _between(cycles, begin)
    middle = _between(cycles, begin + 0.5 * ahead)
    end = _between(cycles, begin + ahead)
    rate = 4.0 * (end - 2.0 * middle + start) / ahead_s**2
    return (end - start) / ahead_s - 0.5 * ahead_s * rate, rate


@brief_kernel
def _between(values: FloatArray, place: float) -> float:
    k = min(max(int(place), 0), values.size - 2)
    value: float = values[k] + (place - k) * (values[k + 1] - values[k])
    return value


NO_GRID = Grid(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Profile:
    """Predicted carrier of one satellite: its cycles on even points, linear between and beyond."""

    grid: Grid  # in samples of the signal's stream
    cycles: FloatArray  # (n,) since the first point
    clock_hz: float  # what open loop adds to it: the receiver's clock, and what is known better

    def __call__(self, sample: int) -> AidingRate:
        """Doppler at a sample and its slope over the update that begins there."""
        frequency_hz, rate_hzps = predicted(*self.grid, self.cycles, sample)
        return AidingRate(frequency_hz, rate_hzps, self.clock_hz)


class Lead(NamedTuple):
    """A carrier led on, and the part of its frequency and rate that is the prediction's."""

    carrier: NcoState
    led_hz: float
    led_hzps: float


@compilable
def follow(
    carrier: NcoState,
    led_hz: float,
    led_hzps: float,
    was: AidingRate,
    aid: AidingRate,
    seconds: float,
    clock: bool,
) -> Lead:
    """Carrier with what a prediction says has changed since one `seconds` before it.

    clock: what open loop adds to it counts, too.
    """
    step_hz = aid.frequency_hz - (was.frequency_hz + seconds * was.rate_hzps)
    step_hzps = aid.rate_hzps - was.rate_hzps
    now_hz = led_hz + (seconds * led_hzps + step_hz)
    if clock:
        step_hz += aid.clock_hz - was.clock_hz
    return Lead(
        NcoState(carrier.phase, carrier.frequency + step_hz, carrier.rate + step_hzps),
        now_hz,
        led_hzps + step_hzps,
    )


class Leading:
    """What was last predicted, and by whom."""

    def __init__(self, sample_rate_hz: float) -> None:
        self.now = NO_AIDING
        self.aided = False  # whether predictions lead the generators
        self.led_hz = 0.0  # the part of the carrier's frequency that is the prediction's
        self.led_hzps = 0.0  # the same of its rate
        self.told_by: AidingSource = unaided
        self._rate = sample_rate_hz

    def rate_anew(self) -> float:
        """Frequency rate for a carrier that forgets its own: the prediction's, Hz/s."""
        self.led_hzps = self.now.rate_hzps
        return self.led_hzps

    def lead(
        self,
        carrier: NcoState,
        source: AidingSource,
        sample: int,
        samples: int,
        mode: Mode,
        *,
        own_rate: bool,
    ) -> NcoState:
        """Carrier with what the prediction says has changed since the last command.

        A loop that follows the carrier takes what the prediction of now says of both instants.
        What a fix has corrected in between is news of the navigation, not a motion: it came of the
        loops' own Dopplers, and would reach them twice.

        Parameters: sample of the last command and how many it lasted; whether the loop has a
        frequency rate of its own.
        """
        was, aid = self.now, source(sample + samples)
        told_before, self.now, self.told_by = self.told_by, aid, source
        led_before, self.aided = self.aided, aid != NO_AIDING
        if not (led_before and self.aided):  # it begins or ends: a loop with a rate goes on
            self.led_hz, self.led_hzps = aid.frequency_hz, aid.rate_hzps
            return carrier if own_rate else carrier._replace(rate=aid.rate_hzps)
        if mode in _FOLLOWING and source is not told_before:
            before = source(sample)
            was = before if own_rate else before._replace(rate_hzps=was.rate_hzps)
        lead = follow(
            carrier,
            self.led_hz,
            self.led_hzps,
            was,
            aid,
            samples / self._rate,
            mode is Mode.HOLD,
        )
        self.led_hz, self.led_hzps = lead.led_hz, lead.led_hzps
        return lead.carrier
