"""HTML and SVG put together from values: whatever is no markup yet is escaped.

`Html` marks text that is markup. Only `element`, `joined` and `document` make it, and they escape
every plain string they are given, so that a name out of a file cannot become a tag or an attribute.
"""

from __future__ import annotations

import html
from collections.abc import Iterable
from typing import Final

POLICY: Final = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
"""What a report may load: nothing. Its styles stand in it, and it has no script."""

_EMPTY: Final = frozenset({"meta", "link", "br", "path", "line", "circle", "rect"})


class Html(str):
    """Text that is markup already."""

    __slots__ = ()


Part = Html | str | None
"""A piece of a page: markup, plain text, or nothing."""


def escaped(part: Part) -> Html:
    """Markup that shows a piece; control characters of a file's text are left out."""
    if isinstance(part, Html):
        return part
    shown = part or ""
    if not shown.isprintable():
        shown = "".join(c for c in shown if c.isprintable() or c == "\n")
    return Html(html.escape(shown, quote=True))


def joined(parts: Iterable[Part]) -> Html:
    """Pieces one after the other."""
    return Html("".join(escaped(part) for part in parts))


def element(name: str, *children: Part, **attributes: str | float | None) -> Html:
    """An element; `class_` stands for class, `_` in a name for `-`, None leaves one out."""
    told = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escaped(_text(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _EMPTY and not children:
        return Html(f"<{name}{told}/>")
    return Html(f"<{name}{told}>{joined(children)}</{name}>")


def _text(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:g}"


def document(title: str, style: str, *body: Part) -> str:
    """A whole page that stands by itself.

    Parameters: style, CSS of ours: it is not escaped.
    """
    head = joined(
        [
            Html('<meta charset="utf-8"/>'),
            element("meta", http_equiv="Content-Security-Policy", content=POLICY),
            element("meta", name_="viewport", content="width=device-width, initial-scale=1"),
            element("meta", name_="color-scheme", content="light dark"),
            element("link", rel="icon", href="data:,"),  # no browser asks for one, then
            element("title", title),
            Html(f"<style>{style}</style>"),
        ]
    )
    page = element("html", element("head", head), element("body", *body), lang="en")
    return f"<!DOCTYPE html>\n{page}\n"
