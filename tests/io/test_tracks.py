import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from run_samples import NOON, no_solution, solution

from deepgnss.io.output import part_path
from deepgnss.io.tracks import GeoJsonTrack, GpxTrack, KmlTrack

_NAME = 'a <b> & "c" \u2192 ]]> \\ d'
_FIXES = [solution(48.0 + 1e-4 * k, -11.5, 500.0 + k, time=NOON.plus(k)) for k in range(3)]


def _tag(element: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    return [e for e in element.iter() if e.tag.endswith("}" + name)]


def test_kml(tmp_path: Path) -> None:
    with KmlTrack(tmp_path / "t.kml", _NAME) as track:
        for fix in (_FIXES[0], no_solution(), *_FIXES[1:]):
            track.write(fix)
    root = ElementTree.parse(tmp_path / "t.kml").getroot()
    assert _tag(root, "name")[0].text == _NAME
    points = (_tag(root, "coordinates")[0].text or "").split()
    assert points[1] == "-11.500000000,48.000100000,501.000"
    assert len(points) == 3


def test_gpx(tmp_path: Path) -> None:
    with GpxTrack(tmp_path / "t.gpx", _NAME) as track:
        for fix in _FIXES:
            track.write(fix)
    root = ElementTree.parse(tmp_path / "t.gpx").getroot()
    points = _tag(root, "trkpt")
    assert [p.attrib["lat"] for p in points] == ["48.000000000", "48.000100000", "48.000200000"]
    assert points[2].attrib["lon"] == "-11.500000000"
    assert _tag(points[1], "time")[0].text == "2022-01-01T12:00:11.000Z"  # UTC = GPST − 18 s
    assert _tag(points[1], "ele")[0].text == "501.000"


@pytest.mark.parametrize(("fixes", "points"), [(0, 0), (1, 2), (2, 2), (3, 3)])
def test_geojson(tmp_path: Path, fixes: int, points: int) -> None:
    with GeoJsonTrack(tmp_path / "t.geojson", _NAME) as track:
        for fix in _FIXES[:fixes]:
            track.write(fix)
    (feature,) = json.loads((tmp_path / "t.geojson").read_text())["features"]
    assert feature["properties"]["name"] == _NAME
    line = feature["geometry"]["coordinates"]
    assert len(line) == points
    if fixes:
        assert line[0] == [-11.5, 48.0, 500.0]


def test_documents_are_whole_at_every_flush(tmp_path: Path) -> None:
    kml, gpx = KmlTrack(tmp_path / "t.kml", _NAME), GpxTrack(tmp_path / "t.gpx", _NAME)
    lines = GeoJsonTrack(tmp_path / "t.geojson", _NAME)
    for fix in _FIXES:
        for track in (kml, gpx, lines):
            track.write(fix)
            track.flush()
        for name in ("t.kml", "t.gpx"):
            ElementTree.parse(part_path(tmp_path / name))
        json.loads(part_path(tmp_path / "t.geojson").read_text())
    for track in (kml, gpx, lines):
        track.close()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["t.geojson", "t.gpx", "t.kml"]
