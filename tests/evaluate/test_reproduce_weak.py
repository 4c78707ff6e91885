"""BIT-20 and FRAME-20 in their quick versions, and the correlator outputs they are made on."""

from __future__ import annotations

import numpy as np
import pytest

from deepgnss.evaluate.reproduce import rows_named, verdict
from deepgnss.evaluate.reproduce.sampled_symbols import sampled_prompts
from deepgnss.evaluate.reproduce.weak_symbols import Residual, received
from deepgnss.receiver.signals import BDS_B1I_D1, GPS_L1CA_SIGNAL, Signal
from deepgnss.receiver.sync import edge_energies


@pytest.mark.parametrize("name", ["BIT-20", "FRAME-20"])
def test_reaches_its_target(name: str) -> None:
    (row,) = rows_named([name])
    assert row.measure is not None
    figures = row.measure(True, [1])
    assert verdict(figures), figures
    assert any(figure.met for figure in figures)


def test_strength_and_residual_of_what_is_received() -> None:
    rng = np.random.default_rng(1)
    still = Residual(0.0, 0.0, 0.0)
    sums = received(np.ones(20_000), 0.02, rng, 20.0, still)
    assert abs(sums.mean()) == pytest.approx(1.0, abs=0.02)
    # Es/N0 = C/N0 · T = 2
    assert np.var(sums) == pytest.approx(0.5, rel=0.03)
    cycles = Residual(2.0, 0.0, 0.0).cycles(100, 0.02, rng)
    np.testing.assert_allclose(np.diff(cycles, 2), 0.0, atol=1e-12)
    slopes = [np.diff(Residual(2.0).cycles(50, 0.02, rng)).mean() / 0.02 for _ in range(400)]
    assert np.std(slopes) == pytest.approx(2.03, rel=0.12)


@pytest.mark.parametrize("signal", [GPS_L1CA_SIGNAL, BDS_B1I_D1])
def test_prompts_from_samples_hold_symbols_where_they_are_said_to_be(signal: Signal) -> None:
    seen = list(sampled_prompts(signal, 0.9, 2, 45.0))
    assert len(seen) == 8
    for one in seen:
        assert int(np.argmax(edge_energies(one.prompts, signal.secondary))) == one.edge
        whole = one.prompts[one.edge :][:840].reshape(-1, 20) @ signal.secondary / 20.0
        assert np.abs(whole).mean() == pytest.approx(1.0, abs=0.04)
