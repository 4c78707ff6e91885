"""Phases corrected in place: only those, the flag beside them, in RINEX 2 and 3."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from deepgnss.io.rinex_obs_reader import read_obs
from deepgnss.io.rinex_repair import PhaseChange, write_changed

_V3 = """\
     3.05           OBSERVATION DATA    G: GPS              RINEX VERSION / TYPE
G    6 C1C L1C S1C C2W L2W S2W                              SYS / # / OBS TYPES
  2023    11    30    10    10   40.0000000     GPS         TIME OF FIRST OBS
                                                            END OF HEADER
> 2023 11 30 10 10 40.0000000  0  2
G03  22406091.675          -0.250 7        45.000    22406095.675    91746437.10237        40.000
G11  25591073.655   134482000.73536        39.000
"""

_V2 = """\
     2.11           OBSERVATION DATA    G (GPS)             RINEX VERSION / TYPE
     6    C1    P2    L1    D1    S1    L2                  # / TYPES OF OBSERV
  2005     4     2     0     0    0.0000000     GPS         TIME OF FIRST OBS
                                                            END OF HEADER
 05  4  2  0  0  0.0000000  0  1G 3
  24767686.375    24767684.822    55923622.16017      1000.000          45.000
  43647388.24247
"""


def _changed(tmp_path: Path, text: str, *changes: PhaseChange) -> tuple[Path, str]:
    source, target = tmp_path / "a.obs", tmp_path / "b.obs"
    source.write_text(text)
    write_changed(target, source, read_obs(source), changes)
    return target, target.read_text()


def test_version_3(tmp_path: Path) -> None:
    changes = (
        PhaseChange(0, "G", "L1C", -1.0, True),
        PhaseChange(0, "G", "L2W", 2.5, False),
        PhaseChange(1, "G", "L1C", 0.0, False),
    )
    path, text = _changed(tmp_path, _V3, *changes)
    wanted = (
        _V3.replace("        -0.250 7", "        -1.25017")
        .replace("91746437.10237", "91746439.60227")  # LLI 3: bit 0 goes, bit 1 stays
        .replace("134482000.73536", "134482000.73526")
    )
    assert text == wanted
    frame = read_obs(path).frame
    np.testing.assert_allclose(frame["L1C"], (-1.25, 134_482_000.735))
    assert frame["L1C_lli"].tolist() == [1, 2] and frame["L2W_lli"].tolist() == [2, 0]


def test_version_2_on_the_second_line(tmp_path: Path) -> None:
    changes = PhaseChange(0, "G", "L2W", 3.0, False), PhaseChange(0, "G", "L1C", 0.0, False)
    path, text = _changed(tmp_path, _V2, *changes)
    assert text == _V2.replace("43647388.24247", "43647391.24247").replace("17  ", " 7  ")
    frame = read_obs(path).frame
    assert frame["L2W"].iloc[0] == 43_647_391.242 and frame["L2W_lli"].iloc[0] == 4


def test_a_phase_that_no_longer_fits_stays(tmp_path: Path) -> None:
    text = _V3.replace(" 134482000.735", "9999999999.735")
    _, changed = _changed(tmp_path, text, PhaseChange(1, "G", "L1C", 1.0, True))
    assert changed == text
