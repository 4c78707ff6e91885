"""A prediction that leads a channel's carrier: fed forward, so that no loop ever sees it."""

from __future__ import annotations

from deepgnss.receiver.modes import NO_AIDING, AidingSource, Mode, unaided
from deepgnss.receiver.trackers import NcoState


class Leading:
    """What was last predicted, and by whom."""

    def __init__(self, sample_rate_hz: float) -> None:
        self.now = NO_AIDING
        self._told_by: AidingSource = unaided
        self._rate = sample_rate_hz

    @property
    def aided(self) -> bool:
        """Whether predictions lead the generators."""
        return self.now != NO_AIDING

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

        A phase loop knows its frequency better than the navigation: it takes what the prediction
        of now says of both instants. What a fix has corrected in between is news of the
        navigation, not a motion.

        Parameters: sample of the last command and how many it lasted; whether the loop has a
        frequency rate of its own.
        """
        was, aid = self.now, source(sample + samples)
        told_before, self.now, self._told_by = self._told_by, aid, source
        if NO_AIDING in (was, aid):  # it begins or ends: a loop with a rate of its own goes on
            return carrier if own_rate else carrier._replace(rate=aid.rate_hzps)
        if mode is Mode.PHASE and source is not told_before:
            before = source(sample)
            was = before if own_rate else before._replace(rate_hzps=was.rate_hzps)
        step_hz = aid.frequency_hz - (was.frequency_hz + samples / self._rate * was.rate_hzps)
        if mode is Mode.HOLD:
            step_hz += aid.clock_hz - was.clock_hz
        return NcoState(
            carrier.phase,
            carrier.frequency + step_hz,
            carrier.rate + aid.rate_hzps - was.rate_hzps,
        )
