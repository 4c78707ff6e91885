"""Pages in headless Chromium: nothing on the console or the network, no sideways scroll."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest
from report_pages import HOSTILE, made_up

from deepgnss.evaluate.report.html import document, element
from deepgnss.evaluate.report.run import run_page

_PHONE_PX = 360
_BROWSER = "not an origin"  # initiator of what the browser asks for by itself: its updates, time


class _Seen(NamedTuple):
    console: list[str]
    requests: list[str]  # by the page: of anything but the file itself
    dom: str


@pytest.fixture(scope="module")
def chromium() -> str:
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if found := shutil.which(name):
            return found
    pytest.skip("no chromium, chromium-browser or google-chrome on this machine")


def _opened(chromium: str, page: str, folder: Path) -> _Seen:
    folder.mkdir(exist_ok=True)
    file, log = folder / "page.html", folder / "net.json"
    file.write_text(page, encoding="utf-8")
    options = ["headless", "no-sandbox", "disable-gpu", "no-first-run", "disable-sync"]
    options += ["disable-background-networking", "disable-component-update"]
    options += ["disable-default-apps", "enable-logging=stderr", "virtual-time-budget=2000"]
    options += [f"log-net-log={log}", f"user-data-dir={folder / 'profile'}", "dump-dom"]
    run = subprocess.run(
        [chromium, *(f"--{option}" for option in options), file.as_uri()],
        capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    console = [line for line in run.stderr.splitlines() if "CONSOLE" in line]
    events = json.loads(log.read_text(encoding="utf-8"))["events"]
    asked = [e["params"] for e in events if "initiator" in e.get("params", {})]
    of_pages = {a["url"] for a in asked if a["initiator"] != _BROWSER and "url" in a}
    return _Seen(console, sorted(of_pages), run.stdout)


def test_a_run_is_shown_without_a_word_or_a_request(chromium: str, tmp_path: Path) -> None:
    seen = _opened(chromium, run_page(made_up(name=HOSTILE)), tmp_path / "run")
    assert "<svg" in seen.dom and seen.console == [] and seen.requests == []


def test_a_page_that_misbehaves_would_be_seen(chromium: str, tmp_path: Path) -> None:
    good = document("a", "", element("p", "b"))
    bad = good.replace("</body>", "<img src='http://127.0.0.1:9/x.png'/></body>")
    assert "Content Security Policy" in " ".join(_opened(chromium, bad, tmp_path / "a").console)
    open_page = re.sub(r"<meta http-equiv[^>]*>", "", bad)
    assert _opened(chromium, open_page, tmp_path / "b").requests == ["http://127.0.0.1:9/x.png"]


def test_a_phone_needs_no_sideways_scroll(chromium: str, tmp_path: Path) -> None:
    page = html.escape(run_page(made_up(name="a_very_long_name_of_a_recording_" * 4)))
    measure = (
        "const e=frame.contentDocument.documentElement;document.title="
        "[e.clientWidth,e.scrollWidth,"
        "Math.min(...[...e.querySelectorAll('body *')].map(x=>parseFloat(getComputedStyle(x)"
        ".fontSize)))].join(' ')"
    )
    frame = (
        f'<iframe id="frame" srcdoc="{page}" style="width:{_PHONE_PX}px;height:9000px;border:0"'
        f' onload="{measure}"></iframe>'
    )
    told = re.search(r"<title>(.*?)</title>", _opened(chromium, frame, tmp_path / "p").dom)
    assert told is not None
    shown_px, needed_px, smallest_px = map(float, told.group(1).split())
    assert (shown_px, needed_px) == (_PHONE_PX, _PHONE_PX)
    assert smallest_px >= 16.0
