"""From configuration to plan: which stream, which settings, what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from deepgnss.core.errors import ConfigError, InputFileError
from deepgnss.core.frames import geodetic
from deepgnss.core.records import NavData, StreamInfo
from deepgnss.core.time import GpsTime
from deepgnss.deep.consistency import check_nav_date
from deepgnss.deep.setup import plan_run
from deepgnss.io.config import Config
from deepgnss.receiver.modes import CarrierSettings, FrequencySettings, KalmanSettings
from deepgnss.sim.constellation import nominal_gps

L1_HZ = 1575.42e6
STREAM = StreamInfo("L1", 4.0e6, L1_HZ, 0.0, True, 40_000_000)


def _config(**sections: Any) -> Config:
    return Config.model_validate({"signals": ["GPS_L1CA"], **sections})


def _stream(
    rate_hz: float, intermediate_hz: float, *, is_complex: bool, centre_hz: float = L1_HZ
) -> StreamInfo:
    return StreamInfo("x", rate_hz, centre_hz, intermediate_hz, is_complex, 10**8)


@pytest.mark.parametrize(
    ("stream", "covered"),
    [
        (_stream(4e6, 0.0, is_complex=True), True),
        (_stream(4e6, -1.9e6, is_complex=True), True),
        (_stream(4e6, 2.1e6, is_complex=True), False),
        (_stream(25e6, 0.0, is_complex=True, centre_hz=L1_HZ - 7e6), True),
        (_stream(4.5e6, 0.0, is_complex=True, centre_hz=1561.098e6), False),
        (_stream(20.48e6, 5.5e6, is_complex=False), True),
        (_stream(20.48e6, -5.5e6, is_complex=False), True),  # inverted, undone by the reader
        (_stream(8e6, 4.1e6, is_complex=False), False),
    ],
)
def test_the_stream_that_holds_the_signal_is_taken(stream: StreamInfo, covered: bool) -> None:
    if covered:
        assert plan_run(_config(), (stream,)).stream is stream
    else:
        with pytest.raises(ConfigError, match="signals: none of GPS_L1CA"):
            plan_run(_config(), (stream,))


def test_of_several_streams_the_right_one() -> None:
    beidou = _stream(4.5e6, 0.0, is_complex=True, centre_hz=1561.098e6)
    assert plan_run(_config(), (beidou, STREAM)).stream is STREAM


def test_settings_arrive_where_they_belong() -> None:
    """Every value unlike its default and unlike the others."""
    plan = plan_run(
        _config(
            tracking={
                "carrier": {
                    "loop": "pll2",
                    "bandwidth": 11.0,
                    "coherent": 0.010,
                    "kalman": {
                        "dynamics": 0.7,
                        "adaptive": False,
                        "memory": 2.5,
                        "fading": 1.02,
                        "square_root": False,
                    },
                },
                "code": {"order": 1, "bandwidth": [2.5, 0.4], "spacing": 0.6, "coherent": 0.010},
                "frequency": {
                    "discriminator": "sfft",
                    "bins": 7,
                    "window": 0.25,
                    "order": 1,
                    "gain": 0.7,
                    "phase": True,
                },
                "thresholds": {
                    "phase": 31.0,
                    "frequency": 21.0,
                    "lost_after": 4.5,
                    "open_loop": 70,
                },
            },
            acquisition={
                "doppler_max": 7500.0,
                "false_alarm": 0.002,
                "coherent": 0.004,
                "noncoherent": 6,
            },
            positioning={
                "elevation_mask": 12.0,
                "raim": False,
                "ionosphere": "none",
                "troposphere": "none",
            },
            output={"interval": 0.5, "correlations": True},
            deep={"epoch": 0.2},
            start="causal",
            threads=3,
        ),
        (STREAM,),
    )
    tracking, search, pvt = plan.settings.tracking, plan.settings.acquisition, plan.settings.pvt
    kalman = KalmanSettings(0.7, False, 2.5, 1.02, False)
    oscillator = tracking.carrier.oscillator
    assert tracking.carrier == CarrierSettings("pll2", 11.0, 0.010, oscillator, kalman)
    assert tracking.carrier.oscillator.h0_s == 1e-21
    assert tracking.spacing_chips == 0.6
    assert (tracking.code_order, tracking.code_bandwidths_hz) == (1, (2.5, 0.4))
    assert (tracking.phase_threshold_dbhz, tracking.frequency_threshold_dbhz) == (31.0, 21.0)
    assert (tracking.lost_after_s, tracking.open_loop_s) == (4.5, 70.0)
    assert tracking.frequency == FrequencySettings("sfft", 7, 0.25, 1, 0.7, True)
    assert tracking.record_correlations
    assert (search.doppler_max_hz, search.false_alarm) == (7500.0, 0.002)
    assert (search.coherent_s, search.noncoherent) == (0.004, 6)
    assert pvt.elevation_mask_rad == pytest.approx(math.radians(12.0))
    assert (pvt.raim, pvt.ionosphere, pvt.troposphere) == (False, "none", "none")
    assert (plan.settings.output_ns, plan.settings.solution_ns) == (500_000_000, 200_000_000)
    assert (plan.epoch_s, plan.scout, plan.threads) == (0.2, False, 3)


def test_skip_and_duration_count_samples() -> None:
    recording = {"skip": 1.5, "duration": 2.25}
    plan = plan_run(_config(recording=recording), (STREAM,))
    assert (plan.first, plan.end) == (6_000_000, 15_000_000)
    plan = plan_run(_config(recording={"skip": 9.0, "duration": 5.0}), (STREAM,))
    assert (plan.first, plan.end) == (36_000_000, 40_000_000)
    with pytest.raises(ConfigError, match=r"recording.skip: 10.0 s, but the recording lasts 10"):
        plan_run(_config(recording={"skip": 10.0}), (STREAM,))


def test_a_search_longer_than_an_epoch_is_refused() -> None:
    acquisition = {"coherent": 0.020, "noncoherent": 6}
    with pytest.raises(ConfigError, match=r"acquisition.noncoherent: .* do not fit an epoch"):
        plan_run(_config(acquisition=acquisition), (STREAM,))


def test_rough_place_and_date() -> None:
    plan = plan_run(
        _config(position=[52.0, 10.5, 120.0], recording={"start_time": "2022-01-01T12:00:10Z"}),
        (STREAM,),
    )
    assert plan.knowledge.near == plan.knowledge.start == GpsTime(2190, 561_628.0)
    assert plan.knowledge.position_e_m is not None
    lat, lon, height_m = geodetic(plan.knowledge.position_e_m)
    assert (math.degrees(lat), math.degrees(lon)) == pytest.approx((52.0, 10.5))
    assert height_m == pytest.approx(120.0, abs=1e-3)


def test_a_nav_file_gives_the_date_or_is_refused() -> None:
    noon = GpsTime(2200, 300_000.0)
    nav, path = nominal_gps(noon, 100.0), Path("nav.rnx")
    near = check_nav_date(nav, None, path)
    assert near is not None
    assert abs(near.since(noon)) < 7200.0
    assert check_nav_date(nav, noon, path) == noon
    with pytest.raises(InputFileError, match=r"nav.rnx: its ephemerides .* lie [67]\.\d days"):
        check_nav_date(nav, noon.plus(7 * 86_400.0), path)
    with pytest.raises(InputFileError, match=r"nav.rnx: holds no ephemeris"):
        check_nav_date(NavData(), noon, path)
