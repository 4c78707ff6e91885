"""Two front-end chains on one antenna: code phase and Doppler of every satellite, differenced."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tables import markdown

from deepgnss.core.constants import SPEED_OF_LIGHT_MPS
from deepgnss.io.metadata import open_recording
from deepgnss.receiver.acquisition import AcquisitionSettings, cold_search
from deepgnss.receiver.baseband import running_sums
from deepgnss.receiver.precise import measure
from deepgnss.receiver.signals import GPS_L1CA_SIGNAL

_SEARCH_S = 0.021


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path, help="metadata of a recording with two streams")
    options = parser.parse_args()
    signal = GPS_L1CA_SIGNAL
    chip_m = SPEED_OF_LIGHT_MPS / signal.id.chip_rate_hz
    recording, _ = open_recording(options.recording)
    with recording:
        one, two = (recording.read(k, 0, recording.streams[k].sample_count) for k in (0, 1))
        short = recording.read(0, 0, round(_SEARCH_S * one.stream.sample_rate_hz))
    sums = running_sums(short, signal.id.carrier_hz)
    found = [a for a in cold_search(sums, 0, signal, AcquisitionSettings()) if a.found]
    rows, differences_m, sigmas_m = [], [], []
    for a in sorted(found, key=lambda a: -a.cn0_dbhz):
        first, second = (measure(b, signal, a.prn, a.doppler_hz, a.code_chips) for b in (one, two))
        half = signal.id.code_chips / 2.0
        apart = (second.code_chips - first.code_chips + half) % (2.0 * half) - half
        sigma_m = chip_m * float(np.hypot(first.code_sigma_chips, second.code_sigma_chips))
        differences_m.append(chip_m * apart)
        sigmas_m.append(sigma_m)
        rows.append(
            [
                first.satellite,
                f"{first.cn0_dbhz:.1f}",
                f"{second.cn0_dbhz:.1f}",
                f"{chip_m * apart:+.2f}",
                f"{sigma_m:.2f}",
                f"{second.doppler_hz - first.doppler_hz:+.2f}",
                f"{float(np.hypot(first.doppler_sigma_hz, second.doppler_sigma_hz)):.2f}",
            ]
        )
    heads = ["sat", "C/N0 1", "C/N0 2", "code m", "σ m", "Doppler Hz", "σ Hz"]
    print(markdown(heads, rows))
    weights = np.array(sigmas_m) ** -2.0
    mean_m = float(np.average(differences_m, weights=weights))
    ratio = np.sqrt(np.mean(((np.array(differences_m) - mean_m) / sigmas_m) ** 2))
    seconds = len(one.samples) / one.stream.sample_rate_hz
    print(
        f"\n{1e3 * seconds:.1f} ms; code of {two.stream.name} less {one.stream.name}: mean "
        f"{mean_m:+.2f} ± {weights.sum() ** -0.5:.2f} m, scatter about it {ratio:.2f} σ"
    )


if __name__ == "__main__":
    main()
