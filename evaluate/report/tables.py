"""Tables, tiles and bars of a report."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from deepgnss.evaluate.report.html import Html, Part, element


def table(
    head: Sequence[str], rows: Sequence[Sequence[Part]], words: Collection[int] = (0,)
) -> Html:
    """A table; on a phone every row stands as a card of its own.

    Parameters: words, columns that hold words; the others hold numbers.
    """
    kinds = [None if k in words else "n" for k in range(len(head))]
    return element(
        "table",
        element("thead", element("tr", *map(_heading, head, kinds))),
        element(
            "tbody",
            *(
                element(
                    "tr",
                    *(
                        element("td", cell, class_=kind, data_label=title)
                        for cell, kind, title in zip(row, kinds, head, strict=True)
                    ),
                )
                for row in rows
            ),
        ),
    )


def _heading(title: str, kind: str | None) -> Html:
    return element("th", title, class_=kind)


def tiles(facts: Sequence[tuple[str, str]]) -> Html:
    """The few figures a reader looks for first: (figure, what it is)."""
    return element(
        "ul",
        *(element("li", element("b", told), element("span", what)) for told, what in facts),
        class_="tiles",
    )


def bars(shares: Sequence[tuple[str, float, str]]) -> Html:
    """Shares as bars: (name, 0 to 1, colour)."""
    return element(
        "div",
        *(
            element(
                "div",
                element("span", name),
                element(
                    "div",
                    element("i", style=f"width:{100.0 * share:.2f}%;background:{colour}"),
                ),
                element("em", percent(share)),
                class_="bar",
            )
            for name, share, colour in shares
        ),
        class_="bars",
    )


def percent(share: float) -> str:
    """A share in %, an en dash where there is none."""
    return "–" if not math.isfinite(share) else f"{100.0 * share:.1f} %"


def metres(value: float, digits: int = 2) -> str:
    """A length, an en dash where there is none."""
    if not math.isfinite(value):
        return "–"
    return f"{value:.{digits if abs(value) < 100.0 else 0}f} m".replace("-", "−")


def seconds(value: float) -> str:
    """A time, "not" where it was not reached."""
    return "not" if not math.isfinite(value) else f"{value:g} s"


def clock(seconds_: float) -> str:
    """Time since the start of a recording as a stop watch shows it."""
    whole = math.floor(seconds_ + 1e-6)
    rest = seconds_ - whole
    text = f"{whole // 60}:{whole % 60:02d}"
    if whole >= 3600:
        text = f"{whole // 3600}:{whole % 3600 // 60:02d}:{whole % 60:02d}"
    return text if rest < 0.05 else text + f"{rest:.1f}"[1:]
