"""Our FFT discriminators find the right peak as often as theory says: T figure 3.4."""

from __future__ import annotations

import pytest

from deepgnss.evaluate.peak_probability import PeakShare, peak_shares, threshold_dbhz


def _hold_against_theory(points: list[PeakShare]) -> None:
    off = [(p.share - p.theory) / p.sigma for p in points if p.theory is not None]
    assert max(map(abs, off)) < 4.0
    assert (sum(value**2 for value in off) / len(off)) ** 0.5 < 1.6


def test_peak_shares() -> None:
    points = peak_shares((12.0, 15.0, 17.0, 20.0, 22.0), 600, seed=1)
    _hold_against_theory(points)
    shares = {(p.discriminator, p.cn0_dbhz): p.share for p in points}
    assert shares["FFT", 17.0] > 0.98 > shares["FFT", 12.0] + 0.1
    assert shares["SFFT", 22.0] > 0.97 > shares["SFFT", 17.0] + 0.3
    for name, squared in (("FFT", "SFFT"), ("PFFT", "PSFFT")):
        assert shares[squared, 15.0] < shares[name, 15.0]
    assert shares["PSFFT", 17.0] > shares["SFFT", 17.0]


@pytest.mark.slow
def test_knees_and_the_gain_of_few_bins() -> None:
    cn0s = [float(cn0) for cn0 in range(9, 25)]
    points = peak_shares(cn0s, 6000, seed=2)
    _hold_against_theory(points)
    at_99 = {name: threshold_dbhz(points, name, 0.99) for name in ("FFT", "SFFT")}
    assert at_99["FFT"] == pytest.approx(16.5, abs=1.0)  # published: 17 with bits known
    assert at_99["SFFT"] == pytest.approx(22.0, abs=0.5)  # and 22 without
    for name in ("FFT", "SFFT"):
        gain_db = threshold_dbhz(points, name) - threshold_dbhz(points, f"P{name}")
        assert gain_db == pytest.approx(2.0, abs=0.5)
