"""Running sums block by block, and samples for those who sum themselves."""

from __future__ import annotations

import numpy as np
import pytest
from sampled_code import CARRIER_HZ, stream

from deepgnss.core.records import SampleBlock
from deepgnss.receiver.feed import SumFeed

pytestmark = pytest.mark.kernel
BLOCK_S = 0.5e-3


@pytest.mark.parametrize("rate_hz", [4.0e6, 250.0e6], ids=["every sample", "thinned"])
@pytest.mark.parametrize("passed", [False, True], ids=["all asked for", "one passed over"])
def test_blocks_go_on_where_the_last_ones_ended(rate_hz: float, passed: bool) -> None:
    info = stream(rate_hz)
    epoch = int(5.3 * BLOCK_S * rate_hz)
    epoch -= epoch % 1000  # of whole entries, also where they are thinned
    samples = np.random.default_rng(1).integers(-100, 100, (3 * epoch, 2), dtype=np.int8)

    def read(first: int, count: int) -> SampleBlock:
        return SampleBlock(info, first, samples[first : first + count])

    feed = SumFeed(read, info, CARRIER_HZ, 0, BLOCK_S)
    total = np.concatenate([[0], np.cumsum(samples[:, 0].astype(np.int64))])
    reached = 0
    for k in range(3):  # an epoch's blocks end where it does
        end = (k + 1) * epoch
        stretch = feed.stretch(end)
        assert (stretch is None) == (rate_hz > 100e6)
        if stretch is not None:
            assert stretch.first == max(0, k * epoch - round(1.5e-3 * rate_hz))
            assert stretch.first + stretch.samples == end
        if passed and k == 1:
            feed.pass_over(end)
            reached = end
            continue
        for sums in feed.advance(end):
            at = sums.first + sums.step * np.arange(sums.packed.size)
            differences = (sums.packed - sums.packed[0] + (1 << 31)) >> 32
            np.testing.assert_array_equal(differences, total[at] - total[at[0]])
            assert sums.first <= max(0, reached - 1.4e-3 * rate_hz)
            assert reached < sums.end <= min(end, reached + BLOCK_S * rate_hz)
            reached = sums.end
        assert end - sums.step < reached
