"""The drive another simulator made, aided by its own log: no worse anywhere, and better."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from deepgnss.evaluate.observables import range_errors, satellite_accuracy, usual_satellites
from deepgnss.evaluate.observations import read_observations, read_ranges

_CONFIG = """\
recording:
  streams:
    - name: L1
      format: bits1
      samples: iq
      packing: {{order: msb_first, code: sign_magnitude}}
      sample_rate: 2.6e6
      centre_frequency: 1575.42e6
      intermediate_frequency: 0.0
signals: [GPS_L1CA]
nav: {nav}
start: causal
positioning: {{troposphere: none}}
imu:
  file: {imu}
  lever_arm: [0.4, 0.1, -1.2]
  alignment: {{method: motion}}
  {more}
output: {{interval: 0.2, report: false, nmea: false}}
"""
_SINCE_S = 8.0  # of the first observation: aiding begins there


class _Run(NamedTuple):
    code_m: float
    phase_mm: float
    slips: int
    folder: Path


def _run(data: Path, folder: Path, name: str, *settings: str, more: str = "") -> _Run:
    source = data / "independent" / "drive"
    config, out = folder / f"{name}.yaml", folder / name
    config.write_text(
        _CONFIG.format(nav=source / "brdc0010.22n", imu=source / "imu.csv", more=more)
    )
    given = [part for setting in settings for part in ("--set", setting)]
    command = Path(sys.executable).parent / "deepgnss"
    subprocess.run(
        [command, "process", source / "rec.bin", "--config", config, "-o", out, *given],
        check=True,
        capture_output=True,
    )
    errors = range_errors(
        read_observations(out / "observations.csv"), read_ranges(source / "ranges.csv")
    )
    errors = errors[errors["time_ms"] >= errors["time_ms"].min() + 1e3 * _SINCE_S]
    accuracy = satellite_accuracy(errors, usual_satellites(errors))
    code_m, phase_m = (accuracy[["code_rms_m", "phase_sigma_m"]] ** 2).mean() ** 0.5
    return _Run(float(code_m), 1e3 * float(phase_m), int(accuracy["slips"].sum()), out)


@pytest.mark.slow
@pytest.mark.parametrize(("bandwidth_hz", "gain"), [(7.0, 0.85), (15.0, 1.03)])
def test_aiding_is_no_worse(
    bandwidth_hz: float, gain: float, shared_data: Path, tmp_path: Path
) -> None:
    """A narrow loop gains, a wide one loses nothing."""
    loop = f"tracking.carrier.bandwidth={bandwidth_hz}"
    alone = _run(shared_data, tmp_path, "unaided", loop, "deep=false")
    aided = _run(shared_data, tmp_path, "aided", loop)
    print(f"{bandwidth_hz} Hz: unaided {alone}, aided {aided}")
    assert aided.phase_mm <= gain * alone.phase_mm
    assert aided.code_m <= 1.03 * alone.code_m
    assert aided.slips == alone.slips == 0


@pytest.mark.slow
@pytest.mark.parametrize("offset_s", [0.1, -0.1])
def test_auto_finds_the_delay(offset_s: float, shared_data: Path, tmp_path: Path) -> None:
    """A log moved on purpose: its stamps are late by what was added."""
    source = shared_data / "independent" / "drive" / "imu.csv"
    head, *lines = source.read_text().splitlines()
    moved = tmp_path / "imu.csv"
    rows = [line.split(",", 2) for line in lines]
    moved.write_text(
        "\n".join([head, *(f"{w},{float(t) + offset_s:.6f},{rest}" for w, t, rest in rows)])
    )
    settings = (f"imu.file={moved}", "imu.time_offset=auto")
    run = _run(shared_data, tmp_path, "auto", *settings)
    told = json.loads((run.folder / "summary.json").read_text())["inertial"]
    print(told)
    assert np.abs(told["late_s"] - offset_s) < 0.015
    assert np.abs(told["taken_off_s"] - offset_s) < 0.015
    (warning,) = told["warnings"]
    assert ("late" if offset_s > 0.0 else "early") in warning
