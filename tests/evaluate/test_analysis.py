"""`deepgnss analyze`: published values, a simulation step by step, tables, files, bad input."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result

from deepgnss.cli.main import cli
from deepgnss.evaluate.analysis.monte_carlo import (
    Motion,
    closed_loop_m,
    drawn_mps,
    finer,
    open_loop_m,
    signed_mps,
    times_s,
    white_mps,
)
from deepgnss.evaluate.analysis.published import AGREEMENT, published_figures
from deepgnss.evaluate.analysis.subject import Subject, subject_of
from deepgnss.io.config import grade_of, imu_grade, load_config
from deepgnss.theory.inertial import error_sums
from deepgnss.theory.loop_response import carrier_loop

NORTH = np.array([1.0, 0.0, 0.0])
NOT_ITS_OWN_FORMULAS = {
    "TCXO_L: phase in 100 ms",
    "TCXO_L: frequency in 100 ms",
    "OCXO: frequency in 100 ms",
}
"""Figures that do not follow from their source's equations: docs/analyze.md derives why."""


def run(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["analyze", *arguments])


@pytest.mark.parametrize("name", ["FSAS", "MTi-G"])
def test_sums_are_those_of_a_strapdown_navigation(name: str) -> None:
    """Every error at +1σ on the readings of a unit, open loop and closed: no statistics in it."""
    grade, motion = imu_grade(name), Motion(3.0, 4.0, 20.0, 25.0)
    velocity, way = error_sums(grade, motion.force_n_mps2, times_s(motion), NORTH)
    stepped_mps = signed_mps(grade, motion)
    late = slice(24, None)  # s 1 and on
    np.testing.assert_allclose(stepped_mps[late], velocity.signed[late], rtol=0.003)
    way_m = open_loop_m(stepped_mps, 1.0 / motion.rate_hz)
    np.testing.assert_allclose(way_m[late], way.signed[late], rtol=0.003)
    motion, parts = Motion(12.0, 20.0, 1.0, 100.0), 80
    fed_mps = finer(signed_mps(grade, motion), parts)
    at_s = (np.arange(fed_mps.size) + 0.5) / (motion.rate_hz * parts)
    for order in (2, 3):
        loop = carrier_loop(order, 10.0)
        _, phase = error_sums(grade, motion.force_n_mps2, at_s, NORTH, loop)
        stepped_m = closed_loop_m(fed_mps, 1.0 / (motion.rate_hz * parts), order, 10.0)
        off_m = np.abs(stepped_m - phase.signed).max()
        assert off_m < 0.01 * np.abs(phase.signed).max()


@pytest.mark.parametrize("name", ["FSAS", "MTi-G"])
def test_spread_of_drawn_navigations(name: str) -> None:
    """300 of them: within four of the sample's own σ."""
    grade, motion, runs = imu_grade(name), Motion(3.0, 4.0, 20.0, 5.0), 300
    rng, at = np.random.default_rng(8), [4, 24, 99]
    velocity, way = error_sums(grade, motion.force_n_mps2, times_s(motion)[at], NORTH)
    for kind, make in (("white", white_mps), ("drawn", drawn_mps)):
        stepped = make(grade, motion, runs, rng)
        for sums, one in ((velocity, stepped), (way, open_loop_m(stepped, 1.0 / motion.rate_hz))):
            ratio = one[:, at].std(axis=0) / getattr(sums, kind)
            assert np.abs(ratio - 1.0).max() < 4.0 / math.sqrt(2.0 * runs)


def test_published_values() -> None:
    """Each follows, or is known not to; few runs, so that of the simulation only the sums count."""
    figures = published_figures(runs=10, seed=1)
    for figure in figures:
        assert figure.follows is (figure.what not in NOT_ITS_OWN_FORMULAS), figure.what
        if "sum" in figure.what.split(", ")[-1] and "1σ" not in figure.what:
            assert figure.confirmed, figure.what
    by_name = {figure.what: figure for figure in figures}
    assert len(by_name) == len(figures)
    closed = [f.ours for f in figures if "closed loop" in f.what]
    assert closed == pytest.approx([0.254, 2.008, 1.532, 9.844], rel=1e-3)


@pytest.mark.slow
def test_simulation_agrees_to_three_percent() -> None:
    for figure in published_figures(runs=10_000, seed=2):
        assert figure.confirmed, f"{figure.what}: {figure.simulated:g} for {figure.ours:g}"
    assert AGREEMENT == 0.03


def test_tables_and_files(tmp_path: Path) -> None:
    given = ("--imu", "MTi-G", "--acceleration", "20", "--along", "12", "-o", str(tmp_path))
    result = run("closed-loop", *given, "--order", "2", "--damping", "1", "--bandwidth", "15")
    assert result.exit_code == 0, result.output
    assert "sum of what is drawn once" in result.output
    curves = pd.read_csv(tmp_path / "closed_loop.csv")
    assert curves["sum_deg"].abs().max() == pytest.approx(1.5318, rel=1e-3)
    assert (tmp_path / "closed_loop.png").stat().st_size > 10_000
    result = run("open-loop", "--imu", "FSAS", "--acceleration", "4", "--along", "3",
                 "-o", str(tmp_path))  # fmt: skip
    assert result.exit_code == 0, result.output
    curves = pd.read_csv(tmp_path / "open_loop.csv")
    at_5_s = np.interp(5.0, curves["time_s"], curves["sum_phase_deg"])
    assert at_5_s == pytest.approx(231.53, abs=0.1)
    assert curves["total_1sigma_code_m"].is_monotonic_increasing
    for command in ("discriminator", "jitter"):
        assert run(command, "-o", str(tmp_path)).exit_code == 0, command
    assert run("peaks", "--trials", "5", "-o", str(tmp_path)).exit_code == 0
    for name in ("discriminator", "jitter", "peaks"):
        assert len(pd.read_csv(tmp_path / f"{name}.csv")) > 5
        assert (tmp_path / f"{name}.png").exists()
    assert not list(tmp_path.glob("*.part"))


def test_same_bytes_again(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        run("closed-loop", "-o", str(tmp_path / folder))
    for name in ("closed_loop.csv", "closed_loop.png"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_everything_from_a_configuration(tmp_path: Path) -> None:
    file = tmp_path / "car.yaml"
    file.write_text(
        "recording: {streams: [{format: int8, samples: iq, sample_rate: 4.0e6,"
        " centre_frequency: 1575.42e6}]}\n"
        "imu: {file: none.csv, grade: STIM300}\noscillator: OCXO_K\n"
        "tracking: {carrier: {loop: pll2, bandwidth: 12.0, coherent: 0.010},"
        " frequency: {discriminator: fft, window: 0.2}}\n"
    )
    subject = subject_of(load_config(file, check_files=False))
    assert (subject.grade.name, subject.oscillator.name) == ("STIM300", "OCXO_K")
    assert (subject.order, subject.bandwidth_hz, subject.coherent_s) == (2, 12.0, 0.010)
    assert (subject.window_s, subject.lines) == (0.2, None)
    told = run("closed-loop", "--config", str(file), "--bandwidth", "9")
    assert "order 2, damping 0.707, 9 Hz" in told.output
    assert "STIM300" in told.output


def test_a_unit_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("gyro: {bias: 3600, noise: 0}\naccelerometer: {bias: 1000, noise: 0}\n")
    grade = grade_of(str(file))
    assert grade.name == "mine"
    assert grade.gyro_bias_radps == pytest.approx(math.radians(1.0))
    assert grade.accel_bias_mps2 == pytest.approx(0.01)
    assert run("closed-loop", "--imu", str(file)).exit_code == 0
    file.write_text("gyro: {bias: 3600, nois: 0}\naccelerometer: {bias: 1000, noise: 0}\n")
    failed = run("closed-loop", "--imu", str(file))
    assert failed.exit_code == 2
    assert "nois" in failed.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("closed-loop", "--imu", "MTI"), "expected one of"),
        (("open-loop", "--oscillator", "quartz"), "expected one of"),
        (("closed-loop", "--order", "3", "--damping", "1"), "--damping"),
        (("jitter", "--bandwidth", "30"), "--bandwidth 30: expected at most 20 Hz"),
        (("discriminator", "--interval", "0.5", "--window", "0.3"), "--interval"),
        (("closed-loop", "--config", "/nowhere.yaml"), "cannot be read"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], said: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert said in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_line_of_sight_and_signal() -> None:
    """Overhead a level acceleration along is none; B1I's wave is longer."""
    flat, steep = Subject(along_mps2=10.0), Subject(along_mps2=10.0, elevation_rad=math.pi / 2)
    assert flat.rate_hzps == pytest.approx(10.0 / 0.190294, rel=1e-5)
    assert steep.rate_hzps == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(steep.sight_n, [0.0, 0.0, -1.0], atol=1e-12)
