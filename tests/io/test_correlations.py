from pathlib import Path

import h5py
import numpy as np
import pytest

from deepgnss.core.errors import OutputError
from deepgnss.core.records import Correlations
from deepgnss.io.correlations import CorrelationWriter
from deepgnss.io.output import part_path

_TAPS = {"GPS_L1CA": (0.25, 0.0, -0.25)}


def _record(first: int, periods: int, seed: int) -> Correlations:
    rng = np.random.default_rng(seed)
    taps = rng.normal(size=(periods, 3)) + 1j * rng.normal(size=(periods, 3))
    return Correlations(first, 1e-3, taps.astype(np.complex64).astype(np.complex128))


def _write(path: Path) -> dict[str, list[Correlations]]:
    written: dict[str, list[Correlations]] = {"G05": [], "G31": []}
    with CorrelationWriter(path, _TAPS) as writer:
        for k in range(6):
            for satellite, periods in (("G31", 20), ("G05", 1 + k)):
                record = _record(4000 * k, periods, k)
                written[satellite].append(record)
                writer.write(satellite, "GPS_L1CA", record)
            if k % 2:
                writer.flush()
    return written


def test_periods_come_back_with_their_places(tmp_path: Path) -> None:
    written = _write(tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5") as file:
        assert sorted(file) == ["G05", "G31"]
        for satellite, records in written.items():
            group = file[f"{satellite}/GPS_L1CA"]
            taps = np.concatenate([r.taps for r in records])
            np.testing.assert_array_equal(group["taps"][:], taps)
            assert group["first_sample"][:].tolist() == [r.first for r in records]
            for row, record in zip(group["row"][:], records, strict=True):
                assert group["taps"][row, 1] == record.taps[0, 1]
            assert group.attrs["tap_chips"].tolist() == [0.25, 0.0, -0.25]


def test_readable_at_every_flush_and_deterministic(tmp_path: Path) -> None:
    writer = CorrelationWriter(tmp_path / "a.h5", _TAPS)
    for k in range(3):
        writer.write("G05", "GPS_L1CA", _record(4000 * k, 5, k))
        writer.flush()
        with h5py.File(part_path(tmp_path / "a.h5")) as file:
            assert file["G05/GPS_L1CA/taps"].shape == (5 * (k + 1), 3)
    writer.abandon()
    assert not (tmp_path / "a.h5").exists()
    _write(tmp_path / "b.h5")
    _write(tmp_path / "c.h5")
    assert (tmp_path / "b.h5").read_bytes() == (tmp_path / "c.h5").read_bytes()


def test_memory_is_bounded(tmp_path: Path) -> None:
    writer = CorrelationWriter(tmp_path / "a.h5", _TAPS)
    for k in range(4):
        writer.write("G05", "GPS_L1CA", _record(k, 20_000, k))
    with h5py.File(part_path(tmp_path / "a.h5")) as file:
        assert len(file["G05/GPS_L1CA/taps"]) == 80_000
    writer.close()


def test_other_number_of_taps_and_no_folder(tmp_path: Path) -> None:
    writer = CorrelationWriter(tmp_path / "a.h5", {"GPS_L1CA": (0.5, 0.0)})
    with pytest.raises(OutputError, match="G05 GPS_L1CA: 3 taps, 2 were announced"):
        writer.write("G05", "GPS_L1CA", _record(0, 1, 0))
    writer.close()
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        CorrelationWriter(tmp_path / "file" / "a.h5", _TAPS)
