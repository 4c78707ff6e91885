"""The track for maps: KML, GPX and GeoJSON, each a whole document at every flush."""

from __future__ import annotations

import json
import math
from pathlib import Path
from xml.sax.saxutils import escape, quoteattr

from deepgnss.core.frames import geodetic
from deepgnss.core.records import NavSolution
from deepgnss.io.output import OutputFile, Writer


class _Track(Writer):
    """Passes valid fixes on as degrees and metres above the ellipsoid."""

    def write(self, solution: NavSolution) -> None:
        """Append a fix; an epoch without one is passed over."""
        if solution.valid and self._file is not None:
            lat, lon, height_m = geodetic(solution.r_e_m)
            point = self._point(math.degrees(lat), math.degrees(lon), height_m, solution)
            self._file.write(point)

    def _point(self, lat: float, lon: float, height_m: float, s: NavSolution) -> str:
        raise NotImplementedError


class KmlTrack(_Track):
    """KML 2.2: one LineString, clamped to the ground since KML counts heights from sea level."""

    def __init__(self, path: Path, name: str) -> None:
        tail = "</coordinates></LineString></Placemark>\n</Document></kml>\n"
        self._file = OutputFile(path, lambda: tail)
        self._file.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            '<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
            f"<name>{escape(name)}</name>\n"
            '<Style id="track"><LineStyle><color>ff0055ff</color><width>3</width></LineStyle>'
            "</Style>\n"
            f"<Placemark><name>{escape(name)}</name><styleUrl>#track</styleUrl>\n"
            "<LineString><altitudeMode>clampToGround</altitudeMode><coordinates>\n"
        )

    def _point(self, lat: float, lon: float, height_m: float, s: NavSolution) -> str:
        return f"{lon:.9f},{lat:.9f},{height_m:.3f}\n"


class GpxTrack(_Track):
    """GPX 1.1: one track with UTC times; `ele` is the height above the ellipsoid."""

    def __init__(self, path: Path, name: str, leap_seconds: int | None = None) -> None:
        self._leap_seconds = leap_seconds
        self._file = OutputFile(path, lambda: "</trkseg></trk></gpx>\n")
        self._file.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n'
            f'<gpx version="1.1" creator={quoteattr("deepgnss")} '
            'xmlns="http://www.topografix.com/GPX/1/1">\n'
            f"<trk><name>{escape(name)}</name><trkseg>\n"
        )

    def _point(self, lat: float, lon: float, height_m: float, s: NavSolution) -> str:
        utc = s.time.utc(self._leap_seconds)
        stamp = f"{utc:%Y-%m-%dT%H:%M:%S}.{utc.microsecond // 1000:03d}Z"
        return (
            f'<trkpt lat="{lat:.9f}" lon="{lon:.9f}"><ele>{height_m:.3f}</ele>'
            f"<time>{stamp}</time><sat>{len(s.used)}</sat></trkpt>\n"
        )


class GeoJsonTrack(_Track):
    """GeoJSON (RFC 7946): a LineString; a single fix stands twice, as the RFC asks for two."""

    def __init__(self, path: Path, name: str) -> None:
        self._points = 0
        self._last = ""
        self._file = OutputFile(path, self._tail)
        self._file.write(
            '{"type":"FeatureCollection","features":[{"type":"Feature","properties":'
            f'{{"name":{json.dumps(name)}}},"geometry":{{"type":"LineString","coordinates":[\n'
        )

    def _tail(self) -> str:
        return (f",\n{self._last}" if self._points == 1 else "") + "\n]}}]}\n"

    def _point(self, lat: float, lon: float, height_m: float, s: NavSolution) -> str:
        self._last = f"[{lon:.9f},{lat:.9f},{height_m:.3f}]"
        self._points += 1
        return self._last if self._points == 1 else f",\n{self._last}"
