"""A prediction that leads a channel's carrier: fed forward, so that no loop ever sees it."""

from __future__ import annotations

from deepgnss.receiver.modes import NO_AIDING, AidingSource, Mode, unaided
from deepgnss.receiver.trackers import NcoState

_FOLLOWING = (Mode.PHASE, Mode.WEAK)


class Leading:
    """What was last predicted, and by whom."""

    def __init__(self, sample_rate_hz: float) -> None:
        self.now = NO_AIDING
        self.aided = False  # whether predictions lead the generators
        self.led_hz = 0.0  # the part of the carrier's frequency that is the prediction's
        self._led_hzps = 0.0
        self._told_by: AidingSource = unaided
        self._rate = sample_rate_hz

    def rate_anew(self) -> float:
        """Frequency rate for a carrier that forgets its own: the prediction's, Hz/s."""
        self._led_hzps = self.now.rate_hzps
        return self._led_hzps

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
        told_before, self.now, self._told_by = self._told_by, aid, source
        led_before, self.aided = self.aided, aid != NO_AIDING
        if not (led_before and self.aided):  # it begins or ends: a loop with a rate goes on
            self.led_hz, self._led_hzps = aid.frequency_hz, aid.rate_hzps
            return carrier if own_rate else carrier._replace(rate=aid.rate_hzps)
        if mode in _FOLLOWING and source is not told_before:
            before = source(sample)
            was = before if own_rate else before._replace(rate_hzps=was.rate_hzps)
        step_hz = aid.frequency_hz - (was.frequency_hz + samples / self._rate * was.rate_hzps)
        step_hzps = aid.rate_hzps - was.rate_hzps
        self.led_hz += samples / self._rate * self._led_hzps + step_hz
        self._led_hzps += step_hzps
        if mode is Mode.HOLD:
            step_hz += aid.clock_hz - was.clock_hz
        return NcoState(
            carrier.phase,
            carrier.frequency + step_hz,
            carrier.rate + step_hzps,
        )
