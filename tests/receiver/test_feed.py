"""Running sums block by block, summed when they are asked for or before."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from sampled_code import CARRIER_HZ, stream

from deepgnss.core.records import SampleBlock
from deepgnss.receiver.feed import SumFeed

pytestmark = pytest.mark.kernel
BLOCK_S = 0.5e-3


@pytest.mark.parametrize("rate_hz", [4.0e6, 250.0e6], ids=["every sample", "thinned"])
@pytest.mark.parametrize("ahead", [False, True], ids=["asked for", "before"])
def test_blocks_go_on_where_the_last_ones_ended(rate_hz: float, ahead: bool) -> None:
    info = stream(rate_hz)
    end = int(5.3 * BLOCK_S * rate_hz)
    samples = np.random.default_rng(1).integers(-100, 100, (end, 2), dtype=np.int8)
    asked = []

    def read(first: int, count: int) -> SampleBlock:
        asked.append((first, count))
        return SampleBlock(info, first, samples[first : first + count])

    feed = SumFeed(read, info, CARRIER_HZ, 0, BLOCK_S)
    total = np.concatenate([[0], np.cumsum(samples[:, 0].astype(np.int64))])
    ends = []
    with ThreadPoolExecutor(2) as pool:
        for epoch_end in (end // 2, end):  # an epoch's blocks end where it does
            for sums in feed.advance(epoch_end):
                at = sums.first + sums.step * np.arange(sums.packed.size)
                differences = (sums.packed - sums.packed[0] + (1 << 31)) >> 32
                np.testing.assert_array_equal(differences, total[at] - total[at[0]])
                assert sums.first <= max(0, (ends or [0])[-1] - 1.4e-3 * rate_hz)
                ends.append(int(at[-1]))
                if ahead:
                    list(pool.map(feed.prepare, [epoch_end] * 4))
    assert sums.end <= end < ends[-1] + sums.step
    assert asked == sorted(set(asked))  # each block once
    assert max(length for _, length in asked) == round(BLOCK_S * rate_hz)
    assert sum(length for _, length in asked) == end
