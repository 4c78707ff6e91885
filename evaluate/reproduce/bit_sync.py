"""BIT-20: symbol edges from 300 sums of 20 ms at 20 dB-Hz, T 5.4.3."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from deepgnss.core.records import ComplexArray
from deepgnss.evaluate.reproduce.sampled_symbols import sampled_prompts
from deepgnss.evaluate.reproduce.table import Figure, percent
from deepgnss.evaluate.reproduce.weak_symbols import CN0_DBHZ, PERIOD_S, received
from deepgnss.receiver.signals import BDS_B1I_D1, GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.sync import add_prompts, edge_energies, start_bit_sync, symbol_edge

SUMS = 300
_WAITED = 3  # times as many for the decision in sequence
_NOISE = 1.0 / (10.0 ** (0.1 * CN0_DBHZ) * PERIOD_S)  # of a prompt of unit amplitude
_PIECE = 20  # prompts the channel hands over at a time


class Trial(NamedTuple):
    """What one stretch of prompts gave."""

    energy: bool  # the published decision is right
    likelihood: bool  # the likelihood's is, after as many sums
    decided: int  # sums after which the channel decides; 0: not within three times as many
    wrong: bool  # … and that is wrong


def trial(signal: Signal, rng: np.random.Generator, waited: int = _WAITED) -> Trial:
    """One stretch of prompts with random symbols and a random edge."""
    size = signal.symbol_periods
    edge = int(rng.integers(size))
    symbols = rng.choice([-1.0, 1.0], waited * SUMS + 3)
    count = (waited * SUMS + 1) * size
    signs = np.outer(symbols, signal.secondary).ravel()[size - edge :][:count]
    return decide(signal, received(signs, PERIOD_S, rng), edge, _NOISE)


def decide(signal: Signal, prompts: ComplexArray, edge: int, noise: float) -> Trial:
    """The three decisions on prompts of unit amplitude whose symbols start at period `edge`."""
    size = signal.symbol_periods
    energy = edge_energies(prompts[: (SUMS + 1) * size], signal.secondary)
    state = start_bit_sync(signal.secondary, coded=bool(signal.secondary_code))
    decided, wrong, likely = 0, False, False
    for first in range(0, prompts.size, _PIECE):
        state = add_prompts(state, prompts[first : first + _PIECE], 1.0, noise)
        found = symbol_edge(state)
        if not decided and found is not None:
            decided = state.symbols
            wrong = (found.period, found.alternating) != (edge, False)
        if state.symbols == SUMS and state.likelihood.any():
            likely = int(np.argmax(state.likelihood)) == edge
        if decided and state.symbols >= SUMS:
            break
    return Trial(int(np.argmax(energy)) == edge, likely, decided, wrong)


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Shares of right edges, by energy and by likelihood, and what the channel's decision does."""
    trials = 50 if quick else 1000
    figures = []
    for signal, name, least in ((GPS_L1CA_SIGNAL, "GPS", 0.995), (BDS_B1I_D1, "BDS D1", 1.0)):
        done = [trial(signal, rng) for seed in seeds for rng in _generators(seed, trials, signal)]
        energy = sum(one.energy for one in done)
        likely = sum(one.likelihood for one in done)
        waits = np.array([one.decided for one in done])
        decided = int(np.count_nonzero(waits))
        wrong = sum(one.wrong for one in done)
        half, most = np.quantile(waits[waits > 0] * signal.symbol_s, [0.5, 0.95])
        figures += [
            Figure(f"{name}, 300 sums, energy", percent(energy, len(done)), None),
            Figure(
                f"{name}, 300 sums, likelihood",
                percent(likely, len(done)),
                likely >= least * len(done),
            ),
            Figure(
                f"{name}, as soon as one stands out",
                f"{percent(decided, len(done))} within {_WAITED * SUMS} sums, half in {half:.1f} s,"
                f" 95 % in {most:.1f} s; {wrong} wrong",
                wrong == 0,
            ),
        ]
        if not quick:
            right, count = _from_samples(signal, seeds[0])
            figures.append(
                Figure(f"{name}, 300 sums, from samples", percent(right, count), right == count)
            )
    return figures


def _from_samples(signal: Signal, seed: int) -> tuple[int, int]:
    """Right decisions, and all, on stretches of simulated satellites from samples on."""
    size, stretches = signal.symbol_periods, 3
    length = (SUMS + 1) * size
    right = 0
    done = 0
    for one in sampled_prompts(signal, (stretches * length + 3 * size) * PERIOD_S, seed):
        for first in range(0, stretches * length, length):
            prompts = one.prompts[first : first + length]
            found = decide(signal, prompts, (one.edge - first) % size, one.noise)
            right += found.energy and found.likelihood
            done += 1
    return right, done


def _generators(seed: int, trials: int, signal: Signal) -> list[np.random.Generator]:
    root = np.random.SeedSequence([seed, signal.symbol_periods, len(signal.secondary_code)])
    return [np.random.default_rng(child) for child in root.spawn(trials)]
