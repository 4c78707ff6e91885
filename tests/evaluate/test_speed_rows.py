"""What the rows of speed and memory measure with."""

from __future__ import annotations

import sys

import pytest

from deepgnss.core.errors import DeepGnssError
from deepgnss.evaluate.child import run
from deepgnss.evaluate.reproduce.speed import residents_mb

_BUSY = "import time; t = time.process_time()\nwhile time.process_time() < t + 0.3: pass\nprint(7)"


def test_a_child_is_charged_with_its_own_time_and_memory() -> None:
    own = bytearray(b"1" * 900_000_000)  # whoever starts it may be larger
    hungry = run([sys.executable, "-c", f"x = bytearray(b'1' * 300_000_000)\n{_BUSY}"])
    assert hungry.output == "7\n"
    assert 0.3 <= hungry.cpu_s < 2.0
    assert hungry.wall_s >= 0.3
    assert 300.0 < hungry.resident_mb < 700.0 < len(own) / 1e6
    idle = run([sys.executable, "-c", "import time; time.sleep(0.5)"])
    assert idle.wall_s >= 0.5 > idle.cpu_s


def test_a_child_that_fails_says_what_it_said_last() -> None:
    with pytest.raises(DeepGnssError, match=r"exit code 3: no such thing$"):
        run([sys.executable, "-c", "import sys; print('x'); print('no such thing'); sys.exit(3)"])


@pytest.mark.slow
def test_memory_is_watched_over_the_whole_run() -> None:
    seen = residents_mb(31.0)
    assert len(seen) == 3
    assert all(100.0 < mb < 1000.0 for mb in seen)
