"""A suite: limits, baseline, what is written, exit codes."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.core.errors import ConfigError, InputFileError
from deepgnss.evaluate import regress as module
from deepgnss.evaluate.batch import Drive
from deepgnss.evaluate.metrics import NAMES, Metric
from deepgnss.evaluate.regress import read_summary, regress, write_report
from deepgnss.evaluate.suite import SuiteConfig, load_suite

_SUITE = """
name: guard
limits: {fixed_share: {min: 0.95}}
runs:
  - {name: drive, config: drive.yaml, limits: {horizontal_rms_m: {max: 2.0}}}
  - {name: street, config: street.yaml, limits: {fixed_share: {min: 0.5}}}
"""


def _metrics(**changed: float) -> dict[str, Metric]:
    values = dict.fromkeys(NAMES, 1.0) | {"gross_share": 0.0} | changed
    return {name: Metric(value, 0.02) for name, value in values.items()}


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    for name in ("drive", "street"):
        (tmp_path / f"{name}.bin").write_bytes(bytes(8))
        (tmp_path / f"{name}.yaml").write_text(
            f"recording: {{streams: [{{file: {name}.bin, format: int8, sample_rate: 4e6}}]}}\n"
        )
    (tmp_path / "suite.yaml").write_text(_SUITE)
    return tmp_path / "suite.yaml"


def _results(monkeypatch: pytest.MonkeyPatch, **by_run: dict[str, Metric]) -> None:
    def processed(drive: Drive) -> dict[str, Metric]:
        if drive.name not in by_run:
            raise InputFileError("error: no position: no satellites")
        return by_run[drive.name]

    monkeypatch.setattr(module, "_processed", processed)


def test_limits_of_a_run_replace_those_of_the_suite(
    suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, poor = _metrics(), _metrics(fixed_share=0.6)
    _results(monkeypatch, drive=good, street=poor)
    assert regress(load_suite(suite), tmp_path).passed
    _results(monkeypatch, drive=poor, street=good)
    report = regress(load_suite(suite), tmp_path)
    assert [(c.run, c.what) for c in report.checks if not c.holds] == [
        ("drive", "fixed_share ≥ 0.95")
    ]


def test_a_metric_that_is_missing_holds_no_limit(
    suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _results(monkeypatch, drive=_metrics(horizontal_rms_m=math.nan), street=_metrics())
    (failed,) = [c for c in regress(load_suite(suite), tmp_path).checks if not c.holds]
    assert failed.what == "horizontal_rms_m ≤ 2" and "no truth" in failed.found


@pytest.mark.parametrize(
    ("name", "value", "worse"),
    [
        ("horizontal_rms_m", 1.05, False),  # within the noise of both, 2·√2·0.02
        ("horizontal_rms_m", 1.06, True),
        ("horizontal_rms_m", 0.5, False),  # better
        ("phases_per_epoch", 0.9, True),
        ("phases_per_epoch", 1.5, False),
        ("first_fix_s", 9.0, True),
    ],
)
def test_the_baseline_bears_noise_and_knows_what_is_better(
    suite: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    value: float,
    worse: bool,
) -> None:
    _results(monkeypatch, drive=_metrics(), street=_metrics())
    write_report(regress(load_suite(suite), tmp_path), tmp_path)
    before = read_summary(tmp_path / "summary.json")
    assert before == {"drive": _metrics(), "street": _metrics()}
    suite.write_text(_SUITE.replace("limits: {horizontal_rms_m: {max: 2.0}}", "limits: {}"))
    _results(monkeypatch, drive=_metrics(**{name: value}), street=_metrics())
    failed = [c for c in regress(load_suite(suite), tmp_path, before).checks if not c.holds]
    assert [c.what for c in failed] == ([f"{name} no worse than before"] if worse else [])


def test_a_run_that_fails_is_a_failure_and_the_others_go_on(
    suite: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _results(monkeypatch, street=_metrics())
    out = tmp_path / "out"
    run = CliRunner().invoke(cli, ["regress", str(suite), "--output", str(out)])
    assert run.exit_code == 1
    root = ElementTree.fromstring((out / "junit.xml").read_text())
    by_name = {part.get("name"): part for part in root}
    assert by_name["drive"].get("failures") == "1"
    assert by_name["street"].get("failures") == "0"
    (failure,) = root.iter("failure")
    assert failure.get("message") == "error: no position: no satellites"
    assert "guard: 1 of 3 failed" in (out / "summary.md").read_text()
    assert json.loads((out / "summary.json").read_text())["passed"] is False


def test_repetitions_are_averaged_and_their_scatter_is_the_noise() -> None:
    each = [_metrics(horizontal_rms_m=value) for value in (1.0, 2.0, 3.0)]
    value, noise = module._mean(each)["horizontal_rms_m"]
    assert (value, noise) == pytest.approx((2.0, 1.0 / math.sqrt(3.0)))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("config: drive.yaml", "scenario: static, config: drive.yaml"), "either config or"),
        (("horizontal_rms_m", "horizontal_rms"), "expected metrics among first_fix_s"),
        (("name: street", "name: drive"), "names that differ"),
        (("{max: 2.0}", "{min: 3.0, max: 2.0}"), "min below max"),
        (("config: street.yaml", "config: none.yaml"), "none.yaml"),
        (("config: street.yaml", "scenario: statik"), "run street: statik: neither a file nor"),
        (("config: street.yaml", "scenario: own.yaml"), "run street: own.yaml: cannot be read"),
        (
            ("config: street.yaml", "scenario: static, scenario_settings: [second=9]"),
            "run street: .*second: unknown key",
        ),
        (("config: street.yaml", "config: street.yaml, settings: [star=1]"), "run street: .*star"),
    ],
)
def test_a_faulty_suite_is_refused_by_its_key(
    suite: Path, change: tuple[str, str], said: str
) -> None:
    suite.write_text(_SUITE.replace(*change))
    with pytest.raises(ConfigError, match=said):
        load_suite(suite)


def test_a_scenario_s_file_lies_beside_the_suite(suite: Path) -> None:
    (suite.parent / "own.yaml").write_text("seconds: 5\ntrajectory: {static: {}}\n")
    suite.write_text(_SUITE.replace("config: street.yaml", "scenario: own.yaml"))
    assert load_suite(suite).runs[1].scenario == str(suite.parent / "own.yaml")


def test_a_baseline_that_is_none_is_one_line(suite: Path, tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text('{"runs": {"drive": 3}}')
    arguments = ["regress", str(suite), "--baseline", str(tmp_path / "summary.json")]
    run = CliRunner().invoke(cli, arguments)
    assert run.exit_code == 2
    assert "not the summary.json of a suite" in run.output


@pytest.mark.slow
def test_a_scenario_is_simulated_and_processed(tmp_path: Path) -> None:
    suite = SuiteConfig.model_validate(
        {
            "runs": [
                {
                    "name": "rest",
                    "scenario": "static",
                    "seeds": [1, 2],
                    "scenario_settings": ["seconds=20", "streams[0].sample_rate=2.61e6"],
                    "assisted": True,
                    "settings": ["signals=[GPS_L1CA]", "start=causal"],
                    "limits": {"fixed_share": {"min": 0.9}, "horizontal_rms_m": {"max": 2.0}},
                }
            ]
        }
    )
    report = regress(suite, tmp_path)
    assert report.passed, report.checks
    assert 0.0 < report.metrics["rest"]["horizontal_rms_m"].noise < 1.0
