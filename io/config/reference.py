"""The reference page of a configuration, written from its schema."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from deepgnss.io.config.messages import models_in
from deepgnss.io.config.quantity import Quantity
from deepgnss.io.config.schema import Config

_HEAD = """# Configuration

One YAML file (YAML 1.2). Every key but `recording.streams[].format` and `sample_rate` has a
default; relative paths start from the file's folder. `deepgnss config FILE --check` looks a file
over, `--show` prints it with all defaults filled in, `--schema` prints the JSON schema.

This page is written from the schema (`make docs`).
"""


def reference_markdown(schema: type[BaseModel] = Config, head: str = _HEAD) -> str:
    """Return the reference of all keys as Markdown, one table per section, below a head."""
    return "\n".join([head, *_sections(schema, "")])


def _sections(model: type[BaseModel], above: str) -> Iterator[str]:
    yield f"## {above}\n" if above else "## At the top\n"
    yield " ".join((model.__doc__ or "").split()) + "\n"
    yield "| key | default | values | meaning |\n|---|---|---|---|"
    inner: list[tuple[str, type[BaseModel]]] = []
    for name, field in model.model_fields.items():
        key = field.alias or name
        section = next(models_in(field.annotation), None)
        if section is None:
            yield _row(key, _default(field), _values(field.annotation, field.metadata), field)
        else:
            several = get_origin(field.annotation) is tuple
            path = f"{above}.{key}".lstrip(".") + ("[]" if several else "")
            inner.append((path, section))
            yield _row(key, _default(field), f"see `{path}`", field, section)
    yield ""
    for path, section in inner:
        yield from _sections(section, path)


def _row(
    key: str, default: str, values: str, field: FieldInfo, section: type[BaseModel] | None = None
) -> str:
    meaning = " ".join((field.description or (section.__doc__ if section else "") or "").split())
    cells = (f"`{key}`", default, values, meaning)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.default
    if value is None or value == ():
        return "none"
    if isinstance(value, BaseModel) or field.default_factory is not None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple):
        if isinstance(value[0], BaseModel):
            return ""  # the keys of the section tell
        return f"[{', '.join(str(part) for part in value)}]"
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _values(annotation: Any, metadata: list[Any]) -> str:
    """What fits, in words: ranges with units, choices, kinds."""
    ranges = [part.describe() for part in metadata if isinstance(part, Quantity)]
    if ranges:
        return ranges[0]
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(f"`{choice}`" for choice in arguments)
    if hasattr(annotation, "__metadata__"):
        return _values(annotation.__origin__, list(annotation.__metadata__))
    if origin in (UnionType, Union):
        kinds = [_values(part, []) for part in arguments if part is not type(None)]
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind))
    if origin is tuple:
        parts = [_values(part, []) for part in arguments if part is not ...]
        return "list: " + "; ".join(dict.fromkeys(parts))
    if origin is dict:
        return "mapping"
    kinds_by_type = {bool: "true, false", str: "text", Path: "path", datetime: "date and time, UTC"}
    return kinds_by_type.get(annotation, "")
