"""signals.png: C/N0 of every satellite of every receiver, coloured by mode where one is told."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch

from deepgnss.evaluate.observables import week_seconds

mpl.use("Agg")

MODE_COLOURS: Final = {
    "PLL": "#0f9d74",
    "FLL": "#e69f00",
    "FFT": "#d55e00",
    "pull-in": "#56b4e9",
    "hold": "#b86aa0",
}
OTHER: Final = "#8a94a1"
"""Of a log that tells no mode."""

_FULL_DBHZ: Final = 50.0
_WEAK_DBHZ: Final = 15.0
_POINTS: Final = 1500


def draw_signals(strengths: Mapping[str, pd.DataFrame], path: Path) -> None:
    """A panel per receiver, a row per satellite, as high as its C/N0 from 15 to 50 dB-Hz.

    Parameters: strengths, by receiver: week, tow_s, satellite, cn0_dbhz, and mode.
    """
    from matplotlib import pyplot as plt

    times = {name: week_seconds(own, 0) for name, own in strengths.items()}
    begin = max(float(t.min()) for t in times.values())
    end = min(float(t.max()) for t in times.values())
    rows = {
        name: sorted(own["satellite"].unique(), reverse=True) for name, own in strengths.items()
    }
    heights = [0.8 + 0.24 * len(names) for names in rows.values()]
    figure, axes = plt.subplots(
        len(rows), 1, figsize=(11.0, sum(heights) + 0.6), layout="constrained",
        height_ratios=heights, squeeze=False, sharex=True,
    )  # fmt: skip
    seen: set[str] = set()
    for axis, (name, own) in zip(axes[:, 0], strengths.items(), strict=True):
        s = times[name] - begin
        inside = (s >= 0.0) & (s <= end - begin) & own["cn0_dbhz"].notna().to_numpy()
        shown = own.assign(s=s)[inside]
        if "mode" not in shown:
            shown = shown.assign(mode="")
        for place, satellite in enumerate(rows[name]):
            track = shown[shown["satellite"] == satellite]
            track = track.iloc[:: max(1, len(track) // _POINTS)]
            size = (track["cn0_dbhz"].to_numpy() - _WEAK_DBHZ) / (_FULL_DBHZ - _WEAK_DBHZ)
            top = place + 0.9 * np.clip(size, 0.03, 1.0)
            step = float(np.median(np.diff(track["s"]))) if len(track) > 1 else 1.0
            for mode in track["mode"].unique():
                here = (track["mode"] == mode).to_numpy()
                colour = MODE_COLOURS.get(str(mode), OTHER)
                x = track["s"].to_numpy()[here]
                corners = np.stack(
                    [
                        np.column_stack((x + a * step, np.where(b, top[here], place)))
                        for a, b in ((-0.5, 0), (-0.5, 1), (0.5, 1), (0.5, 0))
                    ],
                    axis=1,
                )
                axis.add_collection(PolyCollection(list(corners), facecolor=colour, linewidth=0.0))
                seen.add(str(mode) if str(mode) in MODE_COLOURS else "")
        axis.set(title=name, ylim=(0.0, len(rows[name])))
        axis.set_yticks(np.arange(len(rows[name])) + 0.45, rows[name], fontsize=8)
        axis.grid(axis="x", alpha=0.3)
    axes[-1, 0].set(xlabel="time, s", xlim=(0.0, max(end - begin, 1e-3)))
    keys = [
        Patch(color=c, label=m or "lost, or no mode told")
        for m, c in ({**MODE_COLOURS, "": OTHER}).items()
        if m in seen and (m or len(seen) > 1)
    ]
    if keys:
        figure.legend(handles=keys, loc="outside lower center", ncols=6, fontsize=8, frameon=False)
    figure.savefig(path, dpi=110)
    plt.close(figure)
