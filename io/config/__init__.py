"""Configuration of a run: one YAML file, held to a typed schema."""

from deepgnss.io.config.aids import OscillatorConfig, oscillator_names
from deepgnss.io.config.imu_grade import ImuGradeConfig, imu_grade, imu_grade_names
from deepgnss.io.config.load import json_schema, load, load_config, resolved_yaml
from deepgnss.io.config.models import grade_of, oscillator_of
from deepgnss.io.config.notes import notes
from deepgnss.io.config.recording import StreamConfig
from deepgnss.io.config.reference import reference_markdown
from deepgnss.io.config.schema import Config

__all__ = [
    "Config",
    "ImuGradeConfig",
    "OscillatorConfig",
    "StreamConfig",
    "grade_of",
    "imu_grade",
    "imu_grade_names",
    "json_schema",
    "load",
    "load_config",
    "notes",
    "oscillator_names",
    "oscillator_of",
    "reference_markdown",
    "resolved_yaml",
]
