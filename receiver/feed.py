"""Samples on their way into the receiver: running sums, block by block, in the order of time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from deepgnss.core.records import RunningSums, SampleBlock, StreamInfo
from deepgnss.receiver.baseband import RunningSumBuffer, Summable, running_sums

ReadSamples = Callable[[int, int], SampleBlock]
"""Samples [first, first + count) of a stream."""

_CACHED_BYTES = 2_800_000  # of running sums in a block: all channels read them from the cache
_LONGEST_BLOCK_S = 0.02
_HISTORY_S = 0.0015  # kept of the block before: a code period that began there, and margins


class Stretch(NamedTuple):
    """Samples of an epoch for kernels that sum themselves."""

    source: Summable
    samples: int
    first: int  # sample they begin at
    kept: int  # sums that may be looked back at


class SumFeed:
    """The running sums of one stream for one carrier, made once for all channels."""

    def __init__(
        self,
        read: ReadSamples,
        stream: StreamInfo,
        carrier_hz: float,
        first: int,
        block_s: float | None = None,
    ) -> None:
        """Start at sample `first`. block_s: length of a block; no result depends on it."""
        rate = stream.sample_rate_hz
        if block_s is None:
            block_s = min(_LONGEST_BLOCK_S, _CACHED_BYTES / (8.0 * rate))
        self._read = read
        self._carrier_hz = carrier_hz
        self._block = max(1, round(block_s * rate))
        self._history = round(_HISTORY_S * rate)
        self._buffer = RunningSumBuffer(stream, carrier_hz, 2 * self._history + self._block)
        self._buffer.restart(first)
        self._first = self._at = self._buffer.end

    def stretch(self, end: int) -> Stretch | None:
        """Samples up to `end`, with what stands before them, for kernels that sum themselves.

        None: they have to be taken block by block.
        """
        if not self._buffer.as_they_are:
            return None
        first = max(self._first, self._at - self._history)
        source = self._buffer.summable(self._read(first, end - first))
        return Stretch(source, end - first, first, self._history)

    def pass_over(self, end: int) -> None:
        """Go on to sample `end` without sums: nobody wants them."""
        self._at = end

    def advance(self, end: int) -> Iterator[RunningSums]:
        """Go on to sample `end`; each of the sums given holds one more block."""
        buffer = self._buffer
        if buffer.end < self._at:
            buffer.restart(max(self._first, self._at - self._history))
            buffer.append(self._read(buffer.end, self._at - buffer.end))
        while buffer.end < end:
            count = min(self._block, end - buffer.end)
            buffer.keep_from(buffer.end - self._history)
            buffer.append(self._read(buffer.end, count))
            yield buffer.sums
        self._at = end

    def over(self, first: int, count: int) -> RunningSums:
        """Running sums of samples [first, first + count), wherever they are."""
        return running_sums(self._read(first, count), self._carrier_hz)
