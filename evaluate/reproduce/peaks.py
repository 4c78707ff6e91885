"""FFT-PD: how often the largest line of the FFT discriminators is the right one, T figure 3.4."""

from __future__ import annotations

from collections.abc import Sequence

from deepgnss.evaluate.peak_probability import PeakShare, peak_shares
from deepgnss.evaluate.reproduce.table import Figure

LEVELS_DBHZ = (12.0, 14.0, 16.0, 17.0, 18.0, 20.0, 22.0, 24.0)
_KNEES_DBHZ = {"FFT": 17.0, "SFFT": 22.0}  # where the published curves begin to fall
_KNEE_SHARE = 0.98
_SIGMAS = 4.0


def measure(quick: bool, seeds: Sequence[int]) -> list[Figure]:
    """Departure from the integral for FFT and PFFT(3), and where FFT and SFFT begin to err."""
    trials = 300 if quick else 3000
    points = [p for seed in seeds for p in peak_shares(LEVELS_DBHZ, trials, seed)]
    figures = []
    for name in ("FFT", "PFFT"):
        worst = max(_departure(p) for p in points if p.discriminator == name)
        text = f"at most {worst:.1f} σ from the integral ({len(seeds)} × {trials} windows a point)"
        figures.append(
            Figure(f"{name}, {LEVELS_DBHZ[0]:g}–{LEVELS_DBHZ[-1]:g} dB-Hz", text, worst < _SIGMAS)
        )
    for name, knee_dbhz in _KNEES_DBHZ.items():
        shares = [p.share for p in points if (p.discriminator, p.cn0_dbhz) == (name, knee_dbhz)]
        share = sum(shares) / len(shares)
        figures.append(
            Figure(f"{name} at {knee_dbhz:g} dB-Hz", f"{100 * share:.1f} %", share >= _KNEE_SHARE)
        )
    return figures


def _departure(point: PeakShare) -> float:
    """Distance to the integral in its Monte-Carlo error."""
    if point.theory is None:
        raise ValueError(f"{point.discriminator}: has no integral")
    return abs(point.share - point.theory) / point.sigma
