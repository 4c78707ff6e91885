"""Random streams of a scenario: one for each purpose and index, so that none disturbs another."""

from __future__ import annotations

import zlib

import numpy as np


def seed_sequence(seed: int, purpose: str, *index: int) -> np.random.SeedSequence:
    """Entropy of one random part of a scenario; indices are not negative."""
    return np.random.SeedSequence(seed, spawn_key=(zlib.crc32(purpose.encode()), *index))


def random_stream(seed: int, purpose: str, *index: int) -> np.random.Generator:
    """Generator of one random part of a scenario; indices are not negative."""
    return np.random.Generator(np.random.PCG64(seed_sequence(seed, purpose, *index)))
