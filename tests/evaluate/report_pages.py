"""Runs and comparisons made up for tests of their pages, and what a page may not hold."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import numpy as np
import pandas as pd

from deepgnss.core.frames import C_ne, ecef
from deepgnss.evaluate.report.run import RunFiles

HOSTILE = "\"><script>fetch('https://evil.example/x')</script><img src=x onerror='alert(1)'>&\x00"
_LOADING = {"src", "srcset", "href", "xlink:href", "action", "data", "poster", "background", "ping"}
_KNOWN_TAGS = {
    *("html", "head", "meta", "link", "title", "style", "body", "main", "header", "div", "span"),
    *("h1", "h2", "h3", "p", "ul", "li", "b", "i", "em", "br", "figure", "figcaption", "details"),
    *("summary", "pre", "table", "thead", "tbody", "tr", "th", "td", "svg", "path", "circle"),
    "rect",
}


class _Reader(HTMLParser):
    """Collects what a page would load or run, and the tags left open."""

    def __init__(self) -> None:
        super().__init__()
        self.wrong: list[str] = []
        self.open: list[str] = []
        self.policy = ""
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._look_at(tag, attrs)
        if tag not in ("meta", "link", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._look_at(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open.pop() != tag:
            self.wrong.append(f"</{tag}> closes nothing")

    def handle_data(self, data: str) -> None:
        self.text.append(data)
        if self.open[-1:] == ["style"] and re.search(r"url\(|@import|//", data):
            self.wrong.append("style names an address")

    def _look_at(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        told = dict(attrs)
        if tag not in _KNOWN_TAGS:
            self.wrong.append(f"<{tag}>")
        for name, value in attrs:
            if name in _LOADING and value != "data:,":
                self.wrong.append(f"<{tag} {name}={value}>")
            if name.startswith("on") or (name == "style" and "url(" in (value or "")):
                self.wrong.append(f"<{tag} {name}={value}>")
        if told.get("http-equiv") == "Content-Security-Policy":
            self.policy = told["content"] or ""
        elif "http-equiv" in told:
            self.wrong.append(f"<{tag} http-equiv={told['http-equiv']}>")


def faults(page: str) -> list[str]:
    """What in a page would load or run something, or is left open; empty for a good one."""
    reader = _Reader()
    reader.feed(page)
    reader.close()
    wrong = [*reader.wrong, *(f"<{tag}> left open" for tag in reader.open)]
    if "default-src 'none'" not in reader.policy or "script" in reader.policy:
        wrong.append(f"policy: {reader.policy!r}")
    return wrong


def words(page: str) -> str:
    """The text of a page."""
    reader = _Reader()
    reader.feed(page)
    return " ".join(reader.text)


def made_up(
    epochs: int = 60,
    satellites: int = 8,
    gap: tuple[int, int] = (20, 26),
    name: str = "drive.bin",
    per_epoch: int = 1,
    with_truth: bool = True,
) -> RunFiles:
    """A drive north with noise, an outage, and a first position within 3 m two epochs after it."""
    rng = np.random.default_rng(3)
    s = np.arange(epochs, dtype=np.float64)
    ned = np.column_stack((12.0 * s, 30.0 * np.sin(s / 15.0), 0.0 * s))
    off = rng.normal(0.0, 0.5, (epochs, 3))
    off[gap[1] : gap[1] + 2, 1] = 9.0
    lat, lon = np.radians((48.0, 11.0))
    true = ecef(lat, lon, 500.0) + ned @ C_ne(lat, lon)
    places = true + off @ C_ne(lat, lon)
    valid = np.ones(epochs, int)
    valid[gap[0] : gap[1]] = 0
    places[valid == 0], off[valid == 0] = np.nan, np.nan
    time = {"week": np.full(epochs, 2290), "tow_s": 1000.0 + s, "s": s}
    solution = pd.DataFrame({**time, "valid": valid, "used": np.where(valid, 8, 2)})
    solution[["x_e_m", "y_e_m", "z_e_m"]] = places
    solution["reason"] = np.where(valid, "", "2 of 4 satellites needed")
    errors = pd.DataFrame({**time, "north_m": off[:, 0], "east_m": off[:, 1], "down_m": off[:, 2]})
    errors["horizontal_m"] = np.hypot(off[:, 0], off[:, 1])
    errors[["true_x_e_m", "true_y_e_m", "true_z_e_m"]] = true
    names = [f"{'GC'[k % 2]}{k // 2 + 1:02d}" for k in range(satellites)]
    fine = np.arange(epochs * per_epoch) / per_epoch
    channels = pd.DataFrame(
        {
            "s": np.repeat(fine, satellites),
            "satellite": np.tile(names, len(fine)),
            "cn0_dbhz": 40.0 + rng.normal(size=len(fine) * satellites),
            "mode": np.where(
                np.repeat((fine >= gap[0]) & (fine < gap[1]), satellites), "hold", "PLL"
            ),
        }
    )
    sky = pd.DataFrame(
        {
            "satellite": np.tile(names, epochs),
            "azimuth_deg": np.tile(np.arange(satellites) * 43.0 % 360.0, epochs),
            "elevation_deg": np.tile(10.0 + np.arange(satellites) * 29.0 % 75.0, epochs),
            "used": 1,
        }
    )
    outcome = {"signal": "GPS_L1CA", "acquisition_peak": 9.5, "cn0_dbhz": 44.0, "used_epochs": 50}
    summary = {
        "signals": ["GPS_L1CA"],
        "recording_s": float(epochs),
        "first_fix_s": 0.1,
        "config": {"recording": {"skip": 0.0}},
        "satellites": [{"satellite": n, "stage": "used", "reason": "", **outcome} for n in names],
    }
    start_s = 2290 * 604800.0 + 1000.0
    truth = errors if with_truth else None
    return RunFiles(name, solution, sky, channels, truth, None, summary, start_s)
