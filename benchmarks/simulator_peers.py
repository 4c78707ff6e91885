"""What programs that know nothing of us make of simulated data: RTKLIB and GNSS-SDR."""

from __future__ import annotations

import argparse
import math
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import gnss_sdr
import numpy as np
import pandas as pd
from gnss_sdr import Outcome
from tables import markdown

from deepgnss.core.frames import C_ne, geodetic
from deepgnss.core.records import FloatArray
from deepgnss.evaluate import rtklib
from deepgnss.io.config import load_config
from deepgnss.io.recording import Recording
from deepgnss.io.rinex_nav import write_nav
from deepgnss.io.truth import read_truth
from deepgnss.sim.output import write_simulation
from deepgnss.sim.output.stations import base_station, perfect_rover, write_observations
from deepgnss.sim.schema import Simulation, build, load_scenario

FIX_M = 5.0  # from truth, of every fix of GNSS-SDR
FIXED_SHARE = 0.99  # of RTKLIB's epochs
FIXED_M = 0.05
SYSTEMS = ("[GPS]", "[BDS]", "[GPS, BDS]")
SKY = [
    *("satellites.mask=10", "imu=null", "odometer=null"),
    "base={offset: [500, 800, -3], interval: 1}",
]
# Without ionosphere: GNSS-SDR takes off one of its own, not the one that BeiDou sends (a metre).
B1 = [
    *("satellites.systems=[BDS]", "atmosphere.ionosphere=false"),
    "streams=[{name: B1, sample_rate: 6.25e6, centre_frequency: 1561.098e6}]",
]
NARROW = {"pll_bw_hz": "15", "dll_bw_hz": "0.5"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=70.0, help="of samples for GNSS-SDR")
    parser.add_argument("--drive", type=float, default=300.0, help="of observations for RTKLIB, s")
    parser.add_argument("--keep", type=Path, help="folder for all that is written")
    options = parser.parse_args()
    with ExitStack() as stack:
        folder = options.keep or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        passed = [*_rtk(folder, options.drive), *_receivers(folder, options.seconds)]
    if not all(passed):
        raise SystemExit("not all as it must be")


# --- RTKLIB --------------------------------------------------------------------------------------


def _rtk(folder: Path, seconds: float) -> Iterator[bool]:
    if rtklib.installed() is None:
        print("rnx2rtkp is not installed (Debian, Ubuntu: apt install rtklib)\n")
        return
    rows, passed = [], []
    for name, extra in (("open_sky", []), ("urban", ["surroundings=[]"]), ("urban", [])):
        for systems in SYSTEMS:
            place = folder / f"rtk-{len(rows)}"
            settings = [*SKY, *extra, f"seconds={seconds}", f"satellites.systems={systems}"]
            simulation = _observations(place, build(load_scenario(name, settings)))
            files = (place / "rover.obs", place / "base.obs", place / "nav.rnx")
            found = rtklib.kinematic(*files)
            error_m = _error_m(found, simulation)
            fixed = (found["quality"] == rtklib.FIXED).to_numpy()
            open_sky = not simulation.config.surroundings
            if open_sky:
                good = fixed.mean() > FIXED_SHARE and error_m[fixed].max() < FIXED_M
                passed.append(bool(good))
            rows.append(
                [
                    f"{name}{'' if open_sky else ', all obstacles'}, {systems.strip('[]')}",
                    str(len(found)),
                    f"{fixed.mean():.1%}",
                    f"{1e3 * np.sqrt((error_m[fixed] ** 2).mean()):.1f}",
                    f"{1e3 * error_m[fixed].max():.1f}",
                    "" if not open_sky else "yes" if passed[-1] else "NO",
                ]
            )
    print("RTKLIB's rnx2rtkp, rover.obs against base.obs, kinematic, 0.9 km:\n")
    heads = ["scenario", "epochs", "fixed", "3D RMS mm", "largest mm", "as it must be"]
    print(markdown(heads, rows), "\n")
    yield from passed


def _observations(place: Path, simulation: Simulation) -> Simulation:
    """Base, rover and NAV of a scenario, without its samples."""
    scenario, config = simulation.scenario, simulation.config
    place.mkdir(parents=True, exist_ok=True)
    write_nav(place / "nav.rnx", scenario.nav)
    write_observations(place, perfect_rover(config.rover), scenario)
    assert config.base is not None
    write_observations(place, *base_station(config.base, scenario, simulation.unblocked))
    return simulation


def _error_m(found: pd.DataFrame, simulation: Simulation) -> FloatArray:
    """Distance of each position from the antenna's true one."""
    scenario = simulation.scenario
    t_s = (found["week"] - scenario.start.week) * 604_800.0 + found["tow_s"] - scenario.start.tow_s
    true_e_m = scenario.vehicle.point(t_s.to_numpy(), scenario.antennas[0].lever_b_m).r_m
    return np.linalg.norm(found[["x_e_m", "y_e_m", "z_e_m"]].to_numpy() - true_e_m, axis=1)


# --- GNSS-SDR ------------------------------------------------------------------------------------


def _receivers(folder: Path, seconds: float) -> Iterator[bool]:
    program = gnss_sdr.installed()
    if program is None:
        print("gnss-sdr is not installed (Debian, Ubuntu: apt-get install gnss-sdr)")
        return
    cases = {
        "GPS L1 C/A": (["satellites.systems=[GPS]"], [], gnss_sdr.GPS_L1CA, gnss_sdr.EXAMPLE),
        "BeiDou B1I": (B1, ["positioning.ionosphere=none"], gnss_sdr.BDS_B1I, NARROW),
    }
    rows, passed = [], []
    for number, (name, (settings, models, signal, tracking)) in enumerate(cases.items()):
        place = folder / f"receiver-{number}"
        own = [*SKY, *settings, f"seconds={seconds}"]
        written = write_simulation(build(load_scenario("static", own)), place, os.cpu_count() or 1)
        config = load_config(written.config, models)
        samples = (place / "samples.i8").resolve()
        formats = tuple(stream.stream_format() for stream in config.recording.streams)
        with Recording(formats, written.recording) as recording:
            gnss_sdr.write_samples(recording, samples)
        text = gnss_sdr.configuration(samples, config, tracking, 12, signal)
        outcome = gnss_sdr.outcome(program, name, place / "out", text)
        samples.unlink()
        row, good = _fixes(name, outcome, place / "truth.csv")
        rows.append(row)
        passed.append(good)
    print(f"GNSS-SDR {gnss_sdr.version(program)}, antenna at rest, {seconds:g} s:\n")
    heads = ["signal", "satellites", "first fix s", "fixes", "N m", "E m", "D m", "largest 3D m"]
    print(markdown([*heads, "as it must be"], rows))
    yield from passed


def _fixes(name: str, outcome: Outcome, truth_file: Path) -> tuple[Sequence[str], bool]:
    truth = read_truth(truth_file)
    seen = outcome.observed["satellite"].nunique() if len(outcome.observed) else 0
    fixes = outcome.fixes
    if fixes.empty:
        return [name, str(seen), "", "0", "", "", "", "", "NO"], False
    true_e_m, _ = truth.at(fixes["week"].to_numpy().astype(int), fixes["tow_s"].to_numpy())
    inside = np.isfinite(true_e_m).all(axis=1)
    error_e_m = fixes[["x_e_m", "y_e_m", "z_e_m"]].to_numpy()[inside] - true_e_m[inside]
    lat, lon, _ = geodetic(true_e_m[inside][0])
    error_n_m = error_e_m @ C_ne(lat, lon).T
    largest_m = float(np.linalg.norm(error_n_m, axis=1).max()) if inside.any() else math.inf
    cells = [
        f"{mean:+.2f} ± {std:.2f}"
        for mean, std in zip(error_n_m.mean(axis=0), error_n_m.std(axis=0), strict=True)
    ]
    first_s = fixes["tow_s"].min() - truth.start.tow_s
    good = largest_m < FIX_M
    row = [name, str(seen), f"{first_s:.1f}", str(int(inside.sum())), *cells]
    return [*row, f"{largest_m:.2f}", "yes" if good else "NO"], good


if __name__ == "__main__":
    main()
