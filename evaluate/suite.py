"""What a regression suite is made of: its YAML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from deepgnss.core.errors import ConfigError
from deepgnss.evaluate.metrics import NAMES
from deepgnss.io.config import load, load_config
from deepgnss.io.config.quantity import ExistingFile, Section, misfit
from deepgnss.sim.schema import load_scenario


class Limit(Section):
    """Between what a metric must lie."""

    min: float | None = None
    """Not less than this."""
    max: float | None = None
    """Not more than this."""

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.min is None and self.max is None:
            raise misfit("expected min, max or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise misfit(f"expected min below max, found {self.min:g} and {self.max:g}")
        return self

    def holds(self, value: float) -> bool:
        """Whether a value lies within; NaN never does."""
        above = self.min is None or value >= self.min
        return above and (self.max is None or value <= self.max) and value == value

    def __str__(self) -> str:
        parts = [f"≥ {self.min:g}"] if self.min is not None else []
        return " and ".join(parts + ([f"≤ {self.max:g}"] if self.max is not None else []))


class RunConfig(Section):
    """One recording to be processed, or a scenario to be simulated first."""

    name: Annotated[str, Field(pattern=r"^[\w.+-]+$", max_length=64)]
    """In reports, and of the folder of its outputs."""
    config: ExistingFile | None = None
    """Configuration of a recording, which it names; or else …"""
    scenario: str | None = None
    """… a scenario: a file, relative to the suite's folder, or a ready one by its name."""
    seeds: Annotated[tuple[int, ...], Field(min_length=1)] = (1,)
    """One run of the scenario each; the metrics are their means."""
    scenario_settings: tuple[str, ...] = ()
    """KEY=VALUE over those of the scenario."""
    assisted: bool = False
    """Give the run of a scenario its NAV file."""
    settings: tuple[str, ...] = ()
    """KEY=VALUE over those of the configuration."""
    limits: dict[str, Limit] = Field(default_factory=dict)
    """By metric; they replace the suite's."""

    @model_validator(mode="after")
    def _is_one_of_both(self) -> Self:
        if (self.config is None) == (self.scenario is None):
            raise misfit("expected either config or scenario")
        if self.config is not None and (
            self.seeds != (1,) or self.scenario_settings or self.assisted
        ):
            raise misfit("expected neither seeds, scenario_settings nor assisted beside config")
        _require_metrics(self.limits)
        return self


class SuiteConfig(Section):
    """Runs, and what must hold for them."""

    name: str = "deepgnss"
    """In reports."""
    limits: dict[str, Limit] = Field(default_factory=dict)
    """By metric, for every run."""
    runs: Annotated[tuple[RunConfig, ...], Field(min_length=1)]
    """In the order of the reports."""

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [run.name for run in self.runs]
        for name in names:
            if names.count(name) > 1:
                raise misfit(f"expected names that differ, found {name} twice", "runs")
        _require_metrics(self.limits)
        return self


def _require_metrics(limits: dict[str, Limit]) -> None:
    for name in limits:
        if name not in NAMES:
            raise misfit(f"expected metrics among {', '.join(NAMES)}; found {name}", "limits")


def load_suite(path: Path) -> SuiteConfig:
    """Read a suite, and everything its runs name, before the first of them starts.

    Raises ConfigError with one line per key at fault, of the suite or of what a run names.
    """
    suite = load(SuiteConfig, path)
    runs = tuple(_found(run, path) for run in suite.runs)
    for run in runs:
        try:
            if run.config is not None:
                load_config(run.config, run.settings)
            if run.scenario is not None:
                load_scenario(run.scenario, run.scenario_settings)
        except ConfigError as error:
            raise ConfigError(f"{path}: run {run.name}: {error}") from error
    return suite.model_copy(update={"runs": runs})


def _found(run: RunConfig, suite: Path) -> RunConfig:
    """A run whose scenario, where it is a file, is looked for beside the suite."""
    beside = suite.parent / (run.scenario or "")
    return run.model_copy(update={"scenario": str(beside)}) if beside.is_file() else run
