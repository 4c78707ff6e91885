"""`deepgnss info` as a user sees it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from deepgnss.cli.main import cli
from deepgnss.io.container import ContainerWriter
from deepgnss.io.formats import StreamFormat

L1 = 1575.42e6


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    rng = np.random.default_rng(1)
    path = tmp_path / "rec.bin"
    (20 * rng.normal(size=(200_000, 2))).round().astype(np.int8).tofile(path)
    (tmp_path / "car.yaml").write_text(
        "recording: {streams: [{name: front, format: int8, samples: iq, sample_rate: 4.0e6}]}\n"
    )
    return path


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["info", *map(str, arguments)])
    return result.exit_code, result.output


def test_report(recording: Path, tmp_path: Path) -> None:
    code, text = run(
        recording,
        "--config",
        tmp_path / "car.yaml",
        "--no-satellites",
        "--plot",
        tmp_path / "p.png",
    )
    assert code == 0
    for word in ("front", "int8 I/Q, 4 Msps", "0.05 s, 200000 samples", "nothing looks wrong"):
        assert word in text
    assert (tmp_path / "p.png").stat().st_size > 10_000


@pytest.mark.slow
def test_noise_has_no_satellites(recording: Path, tmp_path: Path) -> None:
    code, text = run(recording, "--config", tmp_path / "car.yaml", "--seconds", "0.02")
    assert code == 0
    assert "satellites GPS_L1CA: none found" in text
    assert "no satellites: no antenna" in text


def test_container_needs_no_config(tmp_path: Path) -> None:
    path = tmp_path / "rec.h5"
    with ContainerWriter(path) as writer:
        writer.add_stream(StreamFormat("one", "int16", "real", 4e6, L1, 1e6))
        writer.append("one", np.zeros(5000, np.int16))
    code, text = run(path, "--no-satellites")
    assert code == 0
    assert "1575.42 MHz at 1 MHz" in text
    assert "all samples are zero" in text


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["none.bin"], "no such file"),
        (["rec.bin"], "recording.streams"),
        (["rec.bin", "--config", "car.yaml", "--skip", "9"], "--skip 9"),
        (["rec.bin", "--config", "car.yaml", "--set", "recording.sample=1"], "recording.sample"),
        (["empty.bin", "--config", "car.yaml"], "empty"),
        ([".", "--config", "car.yaml"], "directory"),
    ],
)
def test_bad_input_is_one_line(
    recording: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], word: str
) -> None:
    monkeypatch.chdir(recording.parent)
    (recording.parent / "empty.bin").touch()
    code, text = run(*arguments)
    assert code != 0
    assert word in text
    assert len(text.strip().splitlines()) == 1


def test_ion_pair_through_its_metadata(shared_data: Path) -> None:
    code, text = run(shared_data / "real/if/ion-metadata/SX3_AltBOC_DualRF.smfx", "--seconds", 0.01)
    assert code == 0
    assert text.count("G03") == 2
    assert "2016-01-19 09:00:00 UTC" in text
