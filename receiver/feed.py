"""Samples on their way into the receiver: running sums, block by block, in the order of time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Lock

from deepgnss.core.records import RunningSums, SampleBlock, StreamInfo
from deepgnss.receiver.baseband import RunningSumBuffer, running_sums

ReadSamples = Callable[[int, int], SampleBlock]
"""Samples [first, first + count) of a stream."""

_CACHED_BYTES = 2_800_000  # of running sums in a block: all channels read them from the cache
_LONGEST_BLOCK_S = 0.02
_HISTORY_S = 0.0015  # kept of the block before: a code period that began there, and margins


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
        room = self._history + 1 + self._block
        self._now, self._next = (RunningSumBuffer(stream, carrier_hz, room) for _ in range(2))
        self._now.restart(first)
        self._ready = False  # whether the next block is summed
        self._lock = Lock()

    def prepare(self, end: int) -> None:
        """Sum the next block, up to sample `end` at most, while the present one is still in use.

        Any thread may.
        """
        with self._lock:
            first = self._now.end
            if self._ready or first >= end:
                return
            self._next.go_on_from(self._now, first - self._history)
            self._next.append(self._read(first, min(self._block, end - first)))
            self._ready = True

    def advance(self, end: int) -> Iterator[RunningSums]:
        """Go on to sample `end`; each of the sums given holds one more block, until the next."""
        while self._now.end < end:
            self.prepare(end)
            self._now, self._next, self._ready = self._next, self._now, False
            yield self._now.sums

    def over(self, first: int, count: int) -> RunningSums:
        """Running sums of samples [first, first + count), wherever they are."""
        return running_sums(self._read(first, count), self._carrier_hz)
