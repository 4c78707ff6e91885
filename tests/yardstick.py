"""What work costs on this machine now: CPU time over that of a known piece of work.

CPU seconds alone double when a neighbour keeps the core's other thread or its cache busy.
"""

import time
from collections.abc import Callable

import numpy as np
import scipy.fft

_FIELD = np.ones((820, 4096), np.complex64)


def cost(work: Callable[[], object], tries: int) -> float:
    """Least CPU time of the calling thread, of some tries, over that of 820 FFTs of 4096.

    Those take some 11 ms on a core of 2023; work and yardstick take turns.
    """
    taken, unit = [], []
    for _ in range(tries):
        unit.append(_seconds(lambda: scipy.fft.fft(_FIELD)))
        taken.append(_seconds(work))
    return min(taken) / min(unit)


def _seconds(work: Callable[[], object]) -> float:
    began = time.thread_time()
    work()
    return time.thread_time() - began
