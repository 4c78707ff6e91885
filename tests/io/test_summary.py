import json
from pathlib import Path

import numpy as np
from run_samples import NOON

from deepgnss.core.records import Event
from deepgnss.io.summary import write_summary


def test_everything_a_run_says_is_json(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_summary(
        path,
        {
            "version": "0.1.0",
            "nan": float("nan"),
            "numpy": [np.float64(1.5), np.int64(3), np.bool_(True), np.float32("inf")],
            "array": np.array([[1.0, np.nan]]),
            "time": NOON,
            "event": Event(5, "G05", "lost", "why"),
            "used": {"G12", "G05"},
            "file": Path("rec.bin"),
            "none": None,
        },
    )
    text = path.read_text()
    assert json.loads(text) == {
        "version": "0.1.0",
        "nan": None,
        "numpy": [1.5, 3, True, None],
        "array": [[1.0, None]],
        "time": {"week": 2190, "tow_s": 561628.0},
        "event": {"sample": 5, "satellite": "G05", "what": "lost", "reason": "why"},
        "used": ["G05", "G12"],
        "file": "rec.bin",
        "none": None,
    }
    assert text.index("version") < text.index("nan") < text.index("event")
