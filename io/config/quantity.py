"""Field types of the configuration: numbers with a range and a unit, and files that exist.

Each refuses what does not fit with a text that says what would; nothing is ever clamped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    SerializerFunctionWrapHandler,
    Strict,
    ValidationInfo,
    model_serializer,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

# What a number out of range was probably counted in, by the unit asked for.
_OTHER_UNITS = {
    "Hz": (("MHz", 1e6), ("kHz", 1e3), ("GHz", 1e9)),
    "s": (("ms", 1e-3), ("µs", 1e-6)),
    "deg": (("rad", 180.0 / math.pi),),
    "chips": (("percent", 1e-2),),
}


class Section(BaseModel):
    """A mapping of the configuration: frozen, unknown keys refused, defaults held to the rules."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        validate_default=True,
        populate_by_name=True,
        use_attribute_docstrings=True,
        protected_namespaces=(),
    )


class Choice(Section):
    """A section of keys that exclude each other: written without those that are not given."""

    @model_serializer(mode="wrap")
    def _given_ones(self, whole: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {key: value for key, value in whole(self).items() if value is not None}

    @property
    def given(self) -> list[str]:
        """Names of the keys that have a value."""
        return [name for name in type(self).model_fields if getattr(self, name) is not None]


@dataclass(frozen=True)
class Surroundings:
    """Validation context: where relative paths start, and whether input files must exist."""

    folder: Path
    check_files: bool = True


def misfit(expected: str, key: str = "") -> PydanticCustomError:
    """Error of a value that does not fit; `key` names the key when a section as a whole failed."""
    return PydanticCustomError("misfit", "{expected}", {"expected": expected, "key": key})


@dataclass(frozen=True)
class Quantity:
    """Annotation of a number in [low, high] (or above low, with `above`) of a unit."""

    low: float
    high: float
    unit: str
    above: bool = False
    whole: bool = False

    def describe(self) -> str:
        """Return what would fit, e.g. "1e+06 to 2e+09 Hz"."""
        start = f"above {self.low:g} and up to" if self.above else f"{self.low:g} to"
        return f"{start} {self.high:g} {self.unit}".rstrip()

    def check(self, value: object) -> float | int:
        """Return the value as a float (int when whole), or raise with what would fit."""
        kind = "a whole number" if self.whole else "a number"
        if isinstance(value, bool) or not isinstance(value, int if self.whole else int | float):
            raise misfit(f"expected {kind}, {self.describe()}")
        if not self._holds(value):
            raise misfit(f"expected {self.describe()}{self._hint(value)}")
        return value if self.whole else float(value)

    def _holds(self, value: float) -> bool:
        # NaN fails both comparisons
        return (value > self.low if self.above else value >= self.low) and value <= self.high

    def _hint(self, value: float) -> str:
        for name, scale in _OTHER_UNITS.get(self.unit, ()):
            if self._holds(value * scale):
                return f" ({value:g} {name}? write {value * scale:.9g})"
        return ""

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.check)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        lower = "exclusiveMinimum" if self.above else "minimum"
        kind = "integer" if self.whole else "number"
        return {"type": kind, lower: self.low, "maximum": self.high} | (
            {"unit": self.unit} if self.unit else {}
        )


def _resolve(path: Path, info: ValidationInfo) -> Path:
    around = info.context
    return around.folder / path.expanduser() if isinstance(around, Surroundings) else path


def _existing(path: Path, info: ValidationInfo) -> Path:
    resolved = _resolve(path, info)
    if isinstance(info.context, Surroundings) and info.context.check_files:
        if resolved.is_dir():
            raise misfit("expected a file, this is a folder")
        if not resolved.exists():
            raise misfit(f"no such file: {resolved}")
    return resolved


Switch = Annotated[bool, Strict()]
"""true or false, nothing that looks like it."""

AnyPath = Annotated[Path, AfterValidator(_resolve)]
"""A path, relative to the folder of the configuration file."""

ExistingFile = Annotated[Path, AfterValidator(_existing)]
"""A file that must exist, relative to the folder of the configuration file."""
