"""A drive with two antennas whose observations and inertial log are simulated: files as of a car.

The attitude is that of our loose coupling (`deepgnss ins`) of the simulated unit with noisy fixes:
its errors are an INS's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pymap3d

from deepgnss.core.errors import ConfigError, InputFileError
from deepgnss.core.frames import C_ne
from deepgnss.core.records import FloatArray
from deepgnss.deep.loose import read_inputs, run_loose
from deepgnss.deep.loose_outputs import write_run
from deepgnss.evaluate.antenna_pair import AntennaPair, antenna_pair
from deepgnss.io.config import load_config
from deepgnss.io.config.text import write
from deepgnss.io.output import write_whole
from deepgnss.io.rinex_nav import read_nav, write_nav
from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.truth import read_truth
from deepgnss.sim.output.columns import instants
from deepgnss.sim.output.inertial import imu_settings, write_imu
from deepgnss.sim.output.pair import write_pair
from deepgnss.sim.scenario import Scenario
from deepgnss.sim.schema import ScenarioConfig, build
from deepgnss.sim.seeds import random_stream

_FIX_M, _FIX_MPS = 0.5, 0.05  # 1σ of the fixes by axis

FILES: Final = (
    *("first.obs", "second.obs", "nav.rnx", "imu.csv", "imu_truth.csv", "gnss.txt", "ins.yaml"),
    *("trajectory.csv", "trajectory.nav", "biases.csv", "innovations.csv"),
)
"""Names of all files a simulated drive may leave."""


class PairFiles(NamedTuple):
    """What `deepgnss slips` asks for."""

    first: Path
    second: Path
    nav: Path
    attitude: Path
    baseline_b_m: FloatArray  # (3,) FRD, second − first


def simulate_pair(config: ScenarioConfig, folder: Path, interval_s: float = 1.0) -> PairFiles:
    """Write observations of both antennas, NAV, inertial log, fixes, and the INS's trajectory.

    Raises
    ------
    ConfigError: the scenario lacks a second antenna or an inertial unit.
    """
    if len(config.antennas) < 2:
        raise ConfigError(f"antennas: {config.name} has one, expected two")
    if config.imu is None:
        raise ConfigError(f"imu: {config.name} has none, expected one to tell the attitude")
    simulation = build(config)
    scenario = simulation.scenario
    folder.mkdir(parents=True, exist_ok=True)
    first, second = write_pair(folder, scenario, interval_s)
    write_nav(folder / "nav.rnx", scenario.nav)
    write_imu(folder, simulation)
    _write_fixes(folder / "gnss.txt", scenario)
    start = scenario.start.utc().isoformat(timespec="milliseconds").replace("+00:00", "Z")
    settings = {"recording": {"start_time": start}, "imu": imu_settings(simulation)}
    write_whole(folder / "ins.yaml", write(settings))
    ins = load_config(folder / "ins.yaml", ("ins.smoother=false",))
    run = run_loose(ins, read_inputs(ins, folder / "gnss.txt"))
    if not run.integration.epochs:
        raise InputFileError(f"{config.name}: the INS never aligned: {run.integration.reason}")
    write_run(folder, run)
    arms = [np.array(antenna.lever_b_m) for antenna in scenario.antennas[:2]]
    attitude = folder / "trajectory.csv"
    return PairFiles(first, second, folder / "nav.rnx", attitude, arms[1] - arms[0])


def read_pair(files: PairFiles) -> AntennaPair:
    """What the method works on."""
    way = read_truth(files.attitude)
    places = way.of_point((0.0, 0.0, 0.0)), way.of_point(files.baseline_b_m.tolist())
    return antenna_pair(read_obs(files.first), read_obs(files.second), places, read_nav(files.nav))


def _write_fixes(path: Path, scenario: Scenario) -> None:
    """Fixes of the first antenna every second, KF-GINS text."""
    noise = random_stream(scenario.seed, "fixes of a pair")
    t_s = np.concatenate(list(instants(scenario.start, scenario.seconds, 1.0)))
    motion = scenario.vehicle.point(t_s, scenario.antennas[0].lever_b_m)
    lat, lon, _ = pymap3d.ecef2geodetic(*motion.r_m.T, deg=False)
    to_n = C_ne(np.asarray(lat), np.asarray(lon))
    off_n = _FIX_M * noise.standard_normal(motion.r_m.shape)
    r_e_m = motion.r_m + np.einsum("kji,kj->ki", to_n, off_n)
    v_n = np.einsum("kij,kj->ki", to_n, motion.v_mps)
    v_n += _FIX_MPS * noise.standard_normal(v_n.shape)
    tow_s = [scenario.start.plus(float(t)).tow_s for t in t_s]
    sigmas = np.tile([_FIX_M] * 3 + [_FIX_MPS] * 3, (len(t_s), 1))
    table = np.column_stack([tow_s, *pymap3d.ecef2geodetic(*r_e_m.T), v_n, sigmas])
    write_whole(path, "".join(" ".join(f"{x:.10f}" for x in row) + "\n" for row in table))
