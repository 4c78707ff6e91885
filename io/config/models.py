"""Error models of inertial units and oscillators by the name they ship under, or from a file."""

from __future__ import annotations

from pathlib import Path

from deepgnss.core.errors import ConfigError
from deepgnss.core.records import ImuGrade, Oscillator
from deepgnss.io.config.aids import OscillatorConfig, oscillator_names
from deepgnss.io.config.imu_grade import ImuGradeConfig, imu_grade, imu_grade_names
from deepgnss.io.config.load import load
from deepgnss.io.config.shipped import by_name

_SUFFIXES = (".yaml", ".yml")


def grade_of(name: str) -> ImuGrade:
    """A unit by its name in configs/imu, or a YAML file of the same form.

    Raises
    ------
    ConfigError: neither, or a file that does not fit.
    """
    if not name.endswith(_SUFFIXES):
        if name not in imu_grade_names():
            raise _unknown("IMU grade", name, imu_grade_names())
        return imu_grade(name)
    config = load(ImuGradeConfig, name)
    return config.build()._replace(name=_named(name, config.name))


def oscillator_of(name: str) -> Oscillator:
    """An oscillator by its name in configs/oscillators, or a YAML file of the same form.

    Raises
    ------
    ConfigError: neither, or a file that does not fit.
    """
    if not name.endswith(_SUFFIXES):
        if name not in oscillator_names():
            raise _unknown("oscillator", name, oscillator_names())
        values = by_name("oscillators", name, "h-parameters")
        return OscillatorConfig.model_validate(values).oscillator()
    config = load(OscillatorConfig, name)
    return config.oscillator()._replace(name=_named(name, config.name))


def _named(file: str, name: str) -> str:
    return Path(file).stem if name == "custom" else name


def _unknown(what: str, name: str, names: list[str]) -> ConfigError:
    return ConfigError(f"{what} {name!r}: expected one of {', '.join(names)}, or a YAML file")
