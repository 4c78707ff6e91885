"""From a validation error to one line per key: where, what was found, what would fit."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from deepgnss.io.config.quantity import Quantity
from deepgnss.io.config.text import Location

_KINDS = {
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "text",
    "string_pattern_mismatch": "a name of letters, digits and . + - _",
    "string_too_short": "a name",
    "path_type": "a path",
    "float_type": "a number",
    "float_parsing": "a number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "dict_type": "a mapping (key: value)",
    "model_type": "a mapping (key: value)",
    "model_attributes_type": "a mapping (key: value)",
    "tuple_type": "a list [...]",
    "datetime_type": "date and time, UTC, e.g. 2023-05-12T03:00:00Z",
    "datetime_parsing": "date and time, UTC, e.g. 2023-05-12T03:00:00Z",
    "datetime_from_date_parsing": "date and time, UTC, e.g. 2023-05-12T03:00:00Z",
    "datetime_object_invalid": "date and time, UTC, e.g. 2023-05-12T03:00:00Z",
}


def dotted(location: Location) -> str:
    """Return the key as the user writes it, e.g. "recording.streams[0].format"."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def location_of(key: str) -> Location | None:
    """Return the location of a dotted key, or None when it is not one."""
    if not re.fullmatch(r"[\w-]+(\[\d+\])*(\.[\w-]+(\[\d+\])*)*", key):
        return None
    return tuple(int(p[1:-1]) if p[0] == "[" else p for p in re.findall(r"[\w-]+|\[\d+\]", key))


def explain(error: ValidationError, model: type[BaseModel], data: Any) -> dict[Location, str]:
    """One line for every key at fault: "key: found …; expected …"."""
    expected: dict[Location, list[str]] = {}
    found: dict[Location, str] = {}
    for detail in error.errors(include_url=False):
        location, value = _place(detail, data)
        if (
            detail["type"] == "too_short"
            and value
            and detail["ctx"]["actual_length"] < _length(value)
        ):
            continue  # pydantic counts good members only; the bad ones have lines of their own
        found.setdefault(location, _short(value))
        texts = expected.setdefault(location, [])
        text = _expectation(detail, location, model)
        if text not in texts:
            texts.append(text)
    return {
        location: f"{dotted(location) or 'document'}: " + _sentence(found[location], texts)
        for location, texts in expected.items()
    }


def _length(value: object) -> int:
    return len(value) if isinstance(value, list) else 1  # one value stands for a list of one


def _sentence(found: str, texts: list[str]) -> str:
    if texts[0].startswith(("missing", "unknown")):
        return texts[0]
    # members of a union each say what they expected
    joined = " or ".join([texts[0]] + [text.removeprefix("expected ") for text in texts[1:]])
    return f"found {found}; {joined}"


def _place(detail: ErrorDetails, data: Any) -> tuple[Location, Any]:
    """Location in the user's document and the value there, without pydantic's union tags."""
    parts = list(detail["loc"])
    named = detail.get("ctx", {}).get("key")
    if named:
        parts += location_of(named) or ()
    location: list[str | int] = []
    here: Any = data
    for place, part in enumerate(parts):
        if _holds(here, part):
            here = here[part]
        elif named or (place == len(parts) - 1 and detail["type"] == "missing"):
            here = None  # a key left out
        else:
            continue
        location.append(part)
    return tuple(location), here


def _holds(here: Any, part: str | int) -> bool:
    if isinstance(here, dict):
        return part in here
    return isinstance(here, list) and isinstance(part, int) and part < len(here)


def _expectation(detail: ErrorDetails, location: Location, model: type[BaseModel]) -> str:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind == "misfit":
        return str(context["expected"])
    if kind == "missing":
        return "missing" + _purpose(model, location)
    if kind == "extra_forbidden":
        return "unknown key" + _suggestion(model, location)
    if kind == "literal_error":
        return f"expected {context['expected']}" + _alike(detail["input"], context["expected"])
    if kind in ("too_short", "too_long"):
        low, high = context.get("min_length"), context.get("max_length")
        limit = f"at least {low}" if low is not None else f"at most {high}"
        return f"expected {limit} values, not {context['actual_length']}"
    if kind in _KINDS:
        return f"expected {_KINDS[kind]}"
    return detail["msg"].lower()


def _alike(value: object, expected: str) -> str:
    choices = re.findall(r"'([^']*)'", expected)
    by_fold = {choice.casefold(): choice for choice in choices}
    close = difflib.get_close_matches(str(value).casefold(), by_fold, 1, 0.7)
    return f"; did you mean '{by_fold[close[0]]}'?" if close and len(choices) > 2 else ""


def _short(value: object) -> str:
    if value is None:
        return "nothing"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


# --- what the schema knows of a key --------------------------------------------------------------


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Sections that may stand where a field is annotated so (through Optional, tuple, …)."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from models_in(argument)


def field_keys(model: type[BaseModel]) -> dict[str, str]:
    """Key as written in the file → attribute name, of one section."""
    return {field.alias or name: name for name, field in model.model_fields.items()}


def _section(model: type[BaseModel], location: Location) -> type[BaseModel] | None:
    for part in location:
        if isinstance(part, int):
            continue
        name = field_keys(model).get(part)
        inner = next(models_in(model.model_fields[name].annotation), None) if name else None
        if inner is None:
            return None
        model = inner
    return model


def _purpose(model: type[BaseModel], location: Location) -> str:
    section = _section(model, location[:-1])
    name = field_keys(section).get(str(location[-1])) if section else None
    if section is None or name is None:
        return ""
    field = section.model_fields[name]
    fits = [part.describe() for part in field.metadata if isinstance(part, Quantity)]
    fits += [", ".join(map(str, get_args(field.annotation)))] * (
        get_origin(field.annotation) is Literal
    )
    purpose = " ".join((field.description or "").split()).rstrip(".")
    return f"; {purpose}" + "".join(f": {fit}" for fit in fits)


def _suggestion(model: type[BaseModel], location: Location) -> str:
    section, wrong = _section(model, location[:-1]), str(location[-1])
    if section is None:
        return ""
    keys = list(field_keys(section))
    close = difflib.get_close_matches(wrong.casefold(), keys, 1, 0.6)
    if close:
        return f"; did you mean '{close[0]}'?"
    homes = [home for home in _sections(model) if wrong in field_keys(home[1])]
    if homes:
        return f"; it belongs under '{homes[0][0]}'" if homes[0][0] else "; it belongs at the top"
    return f"; known here: {', '.join(keys)}"


def _sections(model: type[BaseModel], above: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    yield above, model
    for key, name in field_keys(model).items():
        for inner in models_in(model.model_fields[name].annotation):
            yield from _sections(inner, f"{above}.{key}" if above else key)
