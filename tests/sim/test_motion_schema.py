"""The section `trajectory`: what it builds, and what it refuses in one line."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from deepgnss.core.errors import ConfigError
from deepgnss.io.config.messages import explain
from deepgnss.io.config.text import parse
from deepgnss.sim.motion.paths import Motion
from deepgnss.sim.motion.schema import TrajectoryConfig
from deepgnss.sim.motion.vehicle import Vehicle, geographic

PLACE = (math.radians(52.264), math.radians(10.526), 120.0)

TOWN = """
street:
  waypoints: [[0, 0], [600, 0], [900, 100, 4], [900, 700], [500, 700, 12], [500, 1100],
              [-100, 1100], [-300, 900], {north: -300, east: 500, height: 0, radius: 40},
              [-100, 300], [-100, 0]]
  closed: true
  speed: 13.9
  zones: [{from: 1500, to: 1900, speed: 8.3}]
  stops: [{at: 550, seconds: 25}, {at: 1300, seconds: 20}, {at: 2300, seconds: 60},
          {at: 3100, seconds: 40}]
  bank: 0.2
"""


def _built(text: str, seconds: float | None = None) -> Vehicle:
    return TrajectoryConfig.model_validate(parse(text, "scenario")[0]).build(*PLACE, seconds)


def _local(vehicle: Vehicle, *t_s: float) -> Motion:
    return vehicle.path(np.array(t_s))


def test_town_loop_of_ten_minutes() -> None:
    town = _built(TOWN, 600.0)
    assert town.road is not None
    assert 4000.0 < town.road.length_m < 6000.0
    t_s = np.arange(0.0, 600.0, 0.1)
    motion = _local(town, *t_s)
    speed = np.linalg.norm(motion.v_mps, axis=1)
    assert 13.0 < speed.max() < 14.0
    np.testing.assert_allclose(motion.r_m[-1], motion.r_m[0], atol=1e-8)  # once round
    assert 145.0 < 0.1 * (speed == 0.0).sum() < 250.0
    assert np.ptp(motion.r_m[:, 2]) == pytest.approx(12.0, abs=1.0)
    jerk = np.diff(motion.a_mps2, axis=0) / 0.1
    assert np.abs(jerk).max() < 5.0


def test_at_rest_when_nothing_is_said() -> None:
    vehicle = TrajectoryConfig().build(*PLACE)
    assert not np.any(_local(vehicle, 0.0, 5.0))
    turned = geographic(_built("static: {roll: 1, pitch: -2, yaw: 190}").pose(np.zeros(1)))
    assert np.degrees(turned.euler_rad[0]) == pytest.approx([1.0, -2.0, -170.0])
    assert np.degrees(turned.lat_rad[0]) == pytest.approx(52.264)


def test_straight_ones() -> None:
    line = _built("line: {azimuth: 90, elevation: 30, speeds: [[1, 0], [3, 8]]}")
    np.testing.assert_allclose(
        _local(line, 4.0).v_mps[0], [0.0, 8.0 * math.cos(math.pi / 6), -4.0], atol=1e-12
    )
    assert np.degrees(line.attitude(np.zeros(1)).pitch.x) == pytest.approx(30.0)
    steps = _built("steps: {steps: [[1, 980.665], [3, -980.665], [6, 0]], attitude: {yaw: 45}}")
    assert _local(steps, 2.0).a_mps2[0, 0] == pytest.approx(980.665)
    assert steps.attitude(np.zeros(1)).yaw.x == pytest.approx(math.pi / 4)
    sine = _built("sine: {azimuth: 180, amplitude: 2, frequency: 0.25}")
    assert _local(sine, 1.0).r_m[0, 0] == pytest.approx(-2.0)
    away = _built("sine: {amplitude: 2, frequency: 0.25, rest: 3}")
    assert not np.any(_local(away, 3.0))
    peak = _local(away, 4.0)
    assert peak.a_mps2[0, 0] == pytest.approx(2.0 * (math.pi / 2.0) ** 2)
    assert _local(away, 5.0).v_mps[0, 0] == pytest.approx(2.0 * 2.0 * math.pi / 2.0)


def test_round_ones() -> None:
    right = _built("circle: {radius: 50, speeds: [[0, 10]], bank: 1}")
    quarter_s = 50.0 * math.pi / 2.0 / 10.0
    np.testing.assert_allclose(_local(right, quarter_s).r_m[0], [50, 50, 0], atol=1e-9)
    left = _built("circle: {radius: 50, speeds: [[0, 10]], turn: left}")
    np.testing.assert_allclose(_local(left, quarter_s).r_m[0], [50, -50, 0], atol=1e-9)
    assert right.pose(np.zeros(1)).omega_eb_b_radps[0, 2] > 0.1
    assert left.pose(np.zeros(1)).omega_eb_b_radps[0, 2] == pytest.approx(-0.2)
    oval = _built("ellipse: {north: 100, east: 60, speeds: [[0, 12]]}")
    round_s = 2.0 * math.pi * math.sqrt((100.0**2 + 60.0**2) / 2.0) / 12.0
    v_mps = _local(oval, *np.linspace(0.0, round_s, 4001)[:-1]).v_mps
    assert math.sqrt((v_mps**2).sum(axis=1).mean()) == pytest.approx(12.0, rel=1e-6)


def test_waypoints_on_the_globe() -> None:
    vehicle = _built("""
street:
  waypoints:
    - {latitude: 52.264, longitude: 10.526}
    - {latitude: 52.265, longitude: 10.526}
    - {latitude: 52.265, longitude: 10.528}
""")
    assert vehicle.road is not None
    end = vehicle.road.centreline(np.array([vehicle.road.length_m])).r_n_m[0]
    # a thousandth of a degree of the meridian, two of the parallel
    assert end == pytest.approx([111.27, 136.6, 0.0], abs=0.2)


def test_file(tmp_path: Path) -> None:
    file = tmp_path / "track.csv"
    file.write_text("time_s,north_m,east_m,height_m\n0,0,0,0\n1,2,0,0\n2,4,0,1\n3,6,0,1\n")
    vehicle = TrajectoryConfig(file=file).build(*PLACE, 3.0)
    np.testing.assert_allclose(_local(vehicle, 1.0).r_m[0], [2.0, 0.0, 0.0], atol=1e-12)
    with pytest.raises(ConfigError, match=r"ends after 3 s; expected at least the 4 s of the"):
        TrajectoryConfig(file=file).build(*PLACE, 4.0)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("{static: {}, sine: {amplitude: 1, frequency: 1}}", "sine: .*one of static, sine, not"),
        ("line: {speeds: [[0, 1], [0, 2]]}", r"line.speeds\[1\]: .*a second after 0"),
        ("line: {speeds: [[0, 20000]]}", r"line.speeds\[0\]\[1\]: .*-10000 to 10000 m/s"),
        ("steps: {steps: [[1, 500], [1.2, 0]], jerk: 100}", "steps.steps: .*done at 6 s"),
        ("steps: {steps: [[1, 5]], jerk: 5000}", "steps.jerk: .*up to 1000 m/s"),
        ("sine: {amplitude: 5, frequency: 2}", r"amplitude: .*up to 0.5039 m at 2 Hz"),
        ("circle: {radius: 0, speeds: [[0, 5]]}", "circle.radius: .*above 0"),
        ("street: {waypoints: [[0, 0]]}", "street.waypoints: .*at least 2"),
        ("street: {waypoints: [[0, 0], [1]]}", r"street.waypoints\[1\]: "),
        ("street: {waypoints: [[0, 0], {north: 3}]}", r"waypoints\[1\]: .*north and east, or lat"),
        ("street: {waypoints: [[0, 0], [9, 0]], laps: 2}", "street.laps: .*not closed"),
        ("street: {waypoints: [[0, 0], [9, 0]], sped: 2}", "street.sped: unknown key.*'speed'"),
    ],
)
def test_sections_that_cannot_be(text: str, line: str) -> None:
    data: Any = parse(text, "scenario")[0]
    with pytest.raises(ValidationError) as caught:
        TrajectoryConfig.model_validate(data)
    lines = list(explain(caught.value, TrajectoryConfig, data).values())
    assert len(lines) == 1
    assert "\n" not in lines[0]
    assert re.search(line, lines[0])


@pytest.mark.parametrize(
    ("street", "line"),
    [
        ("waypoints: [[0, 0], [50, 0], [50, 50]], radius: 90", r"waypoints\[1\]: the bends"),
        ("waypoints: [[0, 0], [50, 0]], stops: [{at: 60, seconds: 1}]", r"stops\[0\].at: 60 m is"),
        ("waypoints: [[0, 0], [50, 0]], initial_speed: 13", "initial_speed: 13 m/s; the road"),
    ],
)
def test_streets_that_cannot_be(street: str, line: str) -> None:
    with pytest.raises(ConfigError, match=r"^trajectory\.street\." + line) as caught:
        _built(f"street: {{{street}}}")
    assert "\n" not in str(caught.value)
