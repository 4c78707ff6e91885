"""All rows of the table, in its order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from deepgnss.core.errors import ConfigError
from deepgnss.evaluate.reproduce import (
    bit_sync,
    blockage,
    carrier_phase,
    chirps,
    city,
    code_noise,
    false_lock,
    frame_sync,
    high_dynamics,
    kalman_loop,
    long_updates,
    multipath,
    open_loop,
    peaks,
    slips,
    speed,
    turns,
    weak_ranges,
)
from deepgnss.evaluate.reproduce.table import Row

ROWS: Final = (
    Row(
        "CP-S48",
        "static, 48.5 dB-Hz: double difference of phase, σ",
        "0.05 cm",
        "≤ 1.15 · √2 σ_th",
        carrier_phase.measure_strong,
    ),
    Row(
        "CP-D47",
        "dynamic, 47 dB-Hz, tactical and MEMS INS: σ / largest",
        "0.075 / 0.3 cm",
        "≤ 0.06 / 0.25 cm",
        carrier_phase.measure_drive_47,
    ),
    Row(
        "CP-S33",
        "static, 33 dB-Hz: σ",
        "0.30 cm",
        "≤ 1.15 · √2 σ_th, none lost",
        carrier_phase.measure_weak,
    ),
    Row(
        "CP-D35",
        "dynamic, 35 dB-Hz: σ",
        "0.25 / 0.26 cm",
        "≤ 1.2 · √2 σ_th",
        carrier_phase.measure_drive_35,
    ),
    Row(
        "CP-D26",
        "dynamic, 26 dB-Hz: σ, slips",
        "0.70 cm, 0",
        "≤ 1.19 · √2 σ_th, 0 in 300 s",
        carrier_phase.measure_drive_26,
    ),
    Row(
        "CP-TURN",
        "unaided against aided, steps of acceleration: peak phase error",
        "figures 6.9–6.14",
        "within 10 % of theory; aided ≤ 1/10",
        turns.measure,
    ),
    Row(
        "PR-NOISE",
        "static, 48.5 dB-Hz, D, T and B varied: σ of ranges",
        "figures 6.3–6.8",
        "within 10 % of T(2.25)",
        code_noise.measure,
    ),
    Row(
        "PR-W215",
        "dynamic, 21.5 dB-Hz, FFT of 512 ms: σ of ranges / smoothed",
        "3.0 / 3.4, smoothed 1.3 / 1.5 m",
        "≤ 1.1 · √2 σ_th; smoothed ≤ 1.2 / 1.4 m",
        weak_ranges.measure,
    ),
    Row(
        "PR-BACK",
        "47 dB-Hz, back after 20 s of blockage: range error after 1 s",
        "0.5 m",
        "≤ 0.5 m, no search run",
        blockage.measure,
    ),
    Row(
        "PR-MP",
        "one ray of half amplitude, D 1 and D 0.1: largest code error",
        "0.25, 0.025 chip",
        "as theory",
        multipath.measure,
    ),
    Row(
        "FFT-PD",
        "correct-peak probability, 16 × 20 ms: FFT, PFFT(3), SFFT, PSFFT(3)",
        "figure 3.4",
        "within Monte-Carlo error of T(3.26–3.27)",
        peaks.measure,
    ),
    Row(
        "FFT-20G",
        "20 dB-Hz, 100 g for 1 s, aided, window ≤ 320 ms",
        "tracked",
        "tracked, 100 runs of 100",
        high_dynamics.measure,
    ),
    Row(
        "BIT-20",
        "bit sync at 20 dB-Hz, 300 sums: GPS / BDS D1",
        "99.2 / 100 %",
        "≥ 99.5 / 100 %",
        bit_sync.measure,
    ),
    Row(
        "FRAME-20",
        "frame sync at 20 dB-Hz from one frame: GPS / BDS D1; from two: wrong ones",
        "97.7 / 75.8 %; 0 wrong",
        "≥ 98 / 85 %; 0 wrong",
        frame_sync.measure,
    ),
    Row(
        "LOCK-25",
        "false lock at ±25 Hz forced at 20–45 dB-Hz",
        "detected",
        "detected and corrected ≤ 2 s, ≥ 99 %",
        false_lock.measure,
    ),
    Row(
        "OL-S1",
        "static, 1 satellite blocked 20 s: phase error < 0.05 cycle",
        "100 %",
        "100 %",
        open_loop.measure_rest_one,
    ),
    Row(
        "OL-SALL",
        "static, all blocked 20 s: phase error < 0.5 cycle",
        "50 %",
        "≥ 60 % (clock at 50 %); ≥ 0.97 × predicted",
        open_loop.measure_rest_all,
    ),
    Row(
        "OL-D1",
        "dynamic, 1 blocked 5 s: < 0.5 cycle, tactical / MEMS",
        "99 / 83 %",
        "≥ 99 / 90 %",
        open_loop.measure_drive_one,
    ),
    Row(
        "OL-DALL",
        "dynamic, all blocked 5 s: < 0.5 cycle, tactical / MEMS",
        "93 / < 50 %",
        "≥ 95 / 60 %",
        open_loop.measure_drive_all,
    ),
    Row(
        "OL-VALID",
        "predicted 1σ against the measured spread",
        "–",
        "ratio within 0.8–1.25",
        open_loop.measure_prediction,
    ),
    Row(
        "OL-CP",
        "phase settles after 20 s of total blockage",
        "3–4 s",
        "≤ 2 s",
        open_loop.measure_settling,
    ),
    Row(
        "CITY-PR",
        "city drive: differential ranges, σ N / E, CEP, fixed, gross",
        "unaided 3.61 / 1.50, 0.89, 93, 9.25 %; aided 0.80 / 0.93, 0.69, 99, 2.90 %",
        "ratios at least the published ones; fixed ≥ 99.5 %",
        city.measure,
    ),
    Row(
        "CITY-RTK",
        "city drive: right RTK fixes, RTKLIB instantaneous",
        "257 of 297",
        "≥ 1.3 × unaided",
        city.measure_rtk,
    ),
    Row("CITY-EXIT", "city drive: first fix after the tunnel", "1 s", "≤ 1 s", city.measure_exit),
    Row(
        "LFM-CRB",
        "frequency and rate, 400 ms, against the Cramér–Rao bound",
        "on the bound",
        "≤ 1.1 × above threshold",
        chirps.measure,
    ),
    Row(
        "LU-DYN",
        "update of 200 ms, sine: 800 Hz/s, 64 Hz/s², 40 dB-Hz",
        "stable",
        "same, to 80 Hz/s²",
        long_updates.measure_dynamics,
    ),
    Row(
        "LU-SENS",
        "same, 64 and 8 Hz/s²: threshold",
        "23 / 21 dB-Hz",
        "≤ 23 / 21 dB-Hz",
        long_updates.measure_sensitivity,
    ),
    Row(
        "LU-PHASE",
        "phase σ above 30 dB-Hz",
        "< 0.01 cycle",
        "< 0.01 cycle",
        long_updates.measure_phase,
    ),
    Row(
        "KF-STAT",
        "Kalman loop against PLL, static, 43 dB-Hz",
        "errors fall by 1/3 to 1/2",
        "same or better",
        kalman_loop.measure_static,
        quick_s=20.0,
    ),
    Row(
        "KF-DYN",
        "Kalman loop against PLL, sine to 20 g, 2 g/s",
        "errors fall by 1/3 to 1/2",
        "same or better",
        kalman_loop.measure_dynamic,
        quick_s=35.0,
    ),
    Row(
        "SLIP-95",
        "two antennas 2.5 m apart: slips of 1–3 cycles found / false",
        "95 of 95 / 0",
        "100 % / 0 of 1000",
        slips.measure_slips,
    ),
    Row(
        "SLIP-ATT",
        "two antennas 1 m apart: attitude error that still finds 1 cycle",
        "1.375° over 1 s",
        "as theory",
        slips.measure_attitude,
    ),
    Row(
        "SP-CORR",
        "correlator alone: real-time channels per core, C/A, 3 taps, 25 Msps",
        "52 (V100, 1 ms)",
        "≥ 150",
        speed.measure_correlator,
        alone=True,
    ),
    Row(
        "SP-CH",
        "8 GPS at 16 Msps: CPU seconds per channel and second",
        "0.033 (PocketSDR)",
        "≤ 0.012",
        speed.measure_channel,
        alone=True,
    ),
    Row(
        "SP-E2E",
        "12 GPS + 12 BDS, aided, all outputs",
        "–",
        "≥ 5 × real time on two cores",
        speed.measure_everything,
        alone=True,
    ),
    Row(
        "SP-MEM",
        "resident memory, 1 hour of 16 Msps",
        "–",
        "≤ 1 GB, flat",
        speed.measure_memory,
        alone=True,
    ),
)


def rows_named(names: Sequence[str]) -> tuple[Row, ...]:
    """Rows by their ids, all without any.

    Raises ConfigError naming an id that is none.
    """
    known = {row.id: row for row in ROWS}
    for name in names:
        if name not in known:
            raise ConfigError(f"--only {name}: expected one of {', '.join(known)}")
    return tuple(known[name] for name in dict.fromkeys(names)) if names else ROWS
