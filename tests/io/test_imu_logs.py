"""Inertial logs: what is written is read back, what others wrote is read, and what is refused."""

import itertools

import numpy as np
import pytest
from pydantic import ValidationError

from deepgnss.core.errors import ConfigError, DeepGnssError, InputFileError
from deepgnss.core.records import ImuBlock
from deepgnss.core.time import GpsTime
from deepgnss.io.config.aids import ImuConfig
from deepgnss.io.container import ContainerWriter
from deepgnss.io.imu import ENDINGS, ImuLog, ImuWriter
from deepgnss.io.imu.novatel import COUNTS, crc32

ORIGIN = GpsTime(2290, 604_795.0)
FIELDS = ("time_s", "dt_s", "dtheta_b_rad", "dv_b_mps")
# A unit behind its counts to half a count; the others to the last digits of a sum.
FORMATS = [
    ("csv", "increments", "FRD", None),
    ("csv", "rates", "RFU", None),
    ("kfgins", "increments", "FRD", None),
    ("novatel_rawimu", "increments", "RFU", "STIM300"),
    ("novatel_rawimu", "increments", "FLU", "FSAS"),
    ("hdf5", "increments", "FRD", None),
    ("hdf5", "rates", "FLU", None),
]


def drive(n=1000, rate_hz=100.0, seed=4):
    """Increments of a lively drive that crosses the turn of the week after five seconds."""
    rng = np.random.default_rng(seed)
    dtheta = rng.normal(0.0, 0.3, (n, 3)) / rate_hz
    dv = (rng.normal(0.0, 2.0, (n, 3)) + [0.5, -0.2, -9.81]) / rate_hz
    return ImuBlock(ORIGIN, np.arange(1, n + 1) / rate_hz, np.full(n, 1.0 / rate_hz), dtheta, dv)


def write(path, block, *args, cut=400):
    with ImuWriter(path, *args) as writer:
        for part in (slice(0, cut), slice(cut, None)):
            writer.write(ImuBlock(block.origin, *(getattr(block, name)[part] for name in FIELDS)))
        return writer.section(str(path))


def read(keys, **more):
    log = ImuLog(ImuConfig.model_validate(keys), **more)
    blocks = list(log)
    columns = (np.concatenate([getattr(b, name) for b in blocks]) for name in FIELDS)
    return log, ImuBlock(blocks[0].origin, *columns)


def assert_same(got, expected, atol_rad=1e-15, atol_mps=1e-13):
    shift_s = got.origin.since(expected.origin)
    np.testing.assert_allclose(got.time_s + shift_s, expected.time_s, rtol=0, atol=2e-9)
    np.testing.assert_allclose(got.dt_s, expected.dt_s, rtol=0, atol=2e-9)
    np.testing.assert_allclose(got.dtheta_b_rad, expected.dtheta_b_rad, rtol=1e-6, atol=atol_rad)
    np.testing.assert_allclose(got.dv_b_mps, expected.dv_b_mps, rtol=1e-6, atol=atol_mps)


# --- what is written is read back ----------------------------------------------------------------


@pytest.mark.parametrize(("file_format", "kind", "axes", "model"), FORMATS)
def test_round_trip(tmp_path, file_format, kind, axes, model):
    block, path = drive(), tmp_path / f"imu{ENDINGS[file_format]}"
    keys = write(path, block, file_format, kind, axes, model)
    log, got = read(keys, near=ORIGIN)
    counts = COUNTS[model] if model else (0.0, 0.0)
    # times are written to the ns, which is 1e-7 of an interval
    assert_same(got, block, 1e-15 + counts[0], 1e-13 + counts[1])
    assert got.origin.week == 2290 and list(log.faults) == [] and log.outages == []
    assert log.rate_hz == pytest.approx(100.0, rel=1e-6)


def test_counts_of_a_unit_do_not_drift_away(tmp_path):
    block = drive(20_000)
    _, got = read(write(tmp_path / "n.asc", block, "novatel_rawimu", "increments", "FRD", "LN200"))
    lost = got.dv_b_mps.sum(axis=0) - block.dv_b_mps.sum(axis=0)
    assert np.abs(lost).max() <= COUNTS["LN200"].accel_mps  # one count in 20 000 rows
    assert np.abs(got.dv_b_mps - block.dv_b_mps).max() <= 1.01 * COUNTS["LN200"].accel_mps


def test_an_open_container_takes_the_log_beside_its_streams(tmp_path):
    path, block = tmp_path / "rec.h5", drive(50)
    with ContainerWriter(path) as container, ImuWriter(container, "hdf5") as writer:
        writer.write(block)
    _, got = read({"format": "hdf5"}, recording=path)
    assert_same(got, block)


def test_a_log_is_whole_or_a_part(tmp_path):
    path = tmp_path / "imu.csv"
    with pytest.raises(ZeroDivisionError), ImuWriter(path) as writer:
        writer.write(drive(10))
        raise ZeroDivisionError
    assert not path.exists() and (tmp_path / "imu.csv.part").read_text().count("\n") == 11


def test_the_result_does_not_depend_on_the_pieces(tmp_path, monkeypatch):
    path = tmp_path / "imu.csv"
    keys = write(path, drive(5000), "csv")
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:997] + lines[1003:1998] + ["x,,\n"] + lines[2002:]))
    log, whole = read(keys)
    monkeypatch.setattr("deepgnss.io.imu.text.CHUNK_ROWS", 1000)
    other, pieces = read(keys)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=1e-9)
    assert list(log.faults) == list(other.faults)


# --- axes, units, stamps, time scales ------------------------------------------------------------


def rows_of(path, rows, header="gps_week,gps_tow_s,gx,gy,gz,ax,ay,az"):
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows), ""]))
    return path


def test_axes_turn_the_log_to_forward_right_down(tmp_path):
    rows = [(2290, 10.0 + 0.01 * k, 1, 2, 3, 4, 5, 6) for k in range(3)]
    path = rows_of(tmp_path / "imu.csv", rows)
    for axes, turned in (
        ("FRD", (1, 2, 3)),
        ("RFU", (2, 1, -3)),  # x right, y forward, z up
        ("FLU", (1, -2, -3)),
        ("DFR", (2, 3, 1)),
        ([[0, 1, 0], [1, 0, 0], [0, 0, -1]], (2, 1, -3)),
    ):
        _, got = read({"file": str(path), "axes": axes})
        np.testing.assert_allclose(got.dtheta_b_rad[1], turned)
        np.testing.assert_allclose(got.dv_b_mps[1], np.add(turned, np.sign(turned) * 3))
    for axes in ("FLD", "FFU", [[1, 0, 0], [0, 1, 0], [0, 0, -1]], [[1, 0, 0]] * 3):
        with pytest.raises(ValidationError):
            ImuConfig.model_validate({"file": str(path), "axes": axes})


def test_the_24_ways_to_mount_a_unit_and_not_their_mirror_images(tmp_path):
    ways = [a + b + c for a, b, c in itertools.product("FBRLUD", repeat=3)]
    block = drive(10)
    read_back = []
    for letters in ways:
        try:
            keys = {"file": str(tmp_path / "imu.csv"), "axes": letters}
            config = ImuConfig.model_validate(keys)
        except ValidationError:
            continue
        write(config.file, block, "csv", "increments", letters, cut=5)
        assert_same(read(keys)[1], block)
        read_back.append(letters)
    assert len(read_back) == 24 and {"FRD", "RFU", "FLU"} <= set(read_back)


def test_units_of_rates(tmp_path):
    rows = [(2290, 10.0 + 0.1 * k, 18, 0, 0, 0, 0, -1) for k in range(3)]
    path = rows_of(tmp_path / "imu.csv", rows)
    _, got = read({"file": str(path), "kind": "rates", "units": {"gyro": "deg/s", "accel": "g"}})
    np.testing.assert_allclose(got.dtheta_b_rad[:, 0], np.radians(1.8), rtol=1e-9)
    np.testing.assert_allclose(got.dv_b_mps[:, 2], -0.980665, rtol=1e-9)


def test_a_stamp_at_the_start_moves_by_one_interval_and_an_offset_by_itself(tmp_path):
    rows = [(2290, 10.0 + 0.1 * k, k, 0, 0, 0, 0, -1) for k in range(3)]
    keys = {"file": str(rows_of(tmp_path / "imu.csv", rows)), "time_offset": 0.25}
    _, end = read(keys)
    _, start = read(keys | {"stamp": "start"})
    np.testing.assert_allclose(end.time_s, [0.25, 0.35, 0.45])
    np.testing.assert_allclose(start.time_s, [0.35, 0.45, 0.55])
    np.testing.assert_array_equal(start.dtheta_b_rad, end.dtheta_b_rad)
    np.testing.assert_allclose(ImuLog(ImuConfig(**keys), time_offset_s=1.0).__iter__().__next__()
                               .time_s[0], 1.0)  # fmt: skip


def test_samples_of_the_recording_and_ticks(tmp_path):
    rows = [(1000 * k, 0, 0, 0.001 * k, 0, 0, -0.1) for k in range(1, 4)]
    path = str(rows_of(tmp_path / "imu.csv", rows, "sample,gx,gy,gz,ax,ay,az"))
    zero = GpsTime(2290, 604_799.9995)
    _, got = read({"file": path, "time": "sample"}, sample_zero=zero, sample_rate_hz=1e5)
    assert got.origin == zero
    np.testing.assert_allclose(got.time_s, [0.01, 0.02, 0.03])
    with pytest.raises(ConfigError, match=r"imu\.time"):
        ImuLog(ImuConfig(file=path, time="sample"))
    _, got = read({"file": path, "time": "tick", "tick": 1e-5, "start": 5.5}, near=zero)
    assert got.origin == GpsTime(2291, 5.5)  # the nearest such second
    np.testing.assert_allclose(got.time_s, [0.01, 0.02, 0.03])


def test_seconds_without_a_week_take_the_nearest(tmp_path):
    path = tmp_path / "imu.txt"
    path.write_text("".join(f"{604799.9 + 0.1 * k} 0 0 0 0 0 -1\n" if k < 1 else
                            f"{0.1 * (k - 1):.1f} 0 0 0 0 0 -1\n" for k in range(4)))  # fmt: skip
    keys = {"file": str(path), "format": "kfgins"}
    _, got = read(keys, near=GpsTime(2291, 3.0))
    assert got.origin == GpsTime(2290, 604_799.0)
    np.testing.assert_allclose(got.time_s, [0.9, 1.0, 1.1, 1.2])
    _, got = read(keys)
    assert got.origin.week == 0


def test_names_of_columns_as_others_have_them(tmp_path):
    for header in (
        "week;tow;Gyro_X;Gyro_Y;Gyro_Z;Acc_X;Acc_Y;Acc_Z",
        "GPS_WEEK;GPS_TOW_S;dtheta_x_rad;dtheta_y_rad;dtheta_z_rad;dv_x;dv_y;dv_z [m/s]",
    ):
        path = tmp_path / "imu.csv"
        lines = [header, *(f"2290;{k};1;2;3;4;5;6" for k in range(3)), ""]
        path.write_text("# a remark\n" + "\n".join(lines))
        _, got = read({"file": str(path)})
        np.testing.assert_array_equal(got.dtheta_b_rad[2], [1, 2, 3])
        np.testing.assert_array_equal(got.dv_b_mps[2], [4, 5, 6])


# --- gaps, duplicates, numbers that are none -----------------------------------------------------


def ramp(n=200, rate_hz=100.0):
    """Rates that rise linearly: what the straight line of a bridge gets right."""
    k = np.arange(n)
    return [(2290, f"{100.0 + i / rate_hz:.3f}", i, 0, 0, 0, 0, -10) for i in k]


RATES = {"kind": "rates", "units": {"gyro": "rad/s", "accel": "m/s^2"}}


def test_gaps_stay_between_the_intervals_and_are_said(tmp_path):
    rows = ramp(500)
    path = rows_of(tmp_path / "imu.csv", rows[:50] + rows[60:100] + rows[300:])
    log, got = read({"file": str(path)} | RATES)
    assert got.dt_s.size == 290 and got.dt_s == pytest.approx(0.01, rel=1e-6)
    np.testing.assert_allclose(got.dtheta_b_rad[50], [0.6, 0.0, 0.0], rtol=1e-6)  # its own rate
    short, long = log.faults
    assert short == f"{path}:52: gaps of up to 1 s: 1, 0.100 s in all"
    assert long == f"{path}:92: outages of more than 1 s: 1, 2.000 s in all"
    assert log.outages == [(pytest.approx(0.99), pytest.approx(2.99))]
    starts_s = got.time_s - got.dt_s
    holes = np.flatnonzero(starts_s[1:] - got.time_s[:-1] > 1e-3) + 1
    np.testing.assert_allclose(starts_s[holes], [0.59, 2.99], atol=1e-9)


def test_increments_after_a_gap_are_of_their_own_interval(tmp_path):
    rows = [(*row[:2], 0.5, *row[3:]) for row in ramp()]
    path = rows_of(tmp_path / "imu.csv", rows[:50] + rows[53:])
    _, got = read({"file": str(path)})
    assert got.dt_s == pytest.approx(0.01, rel=1e-6)
    assert got.dtheta_b_rad[:, 0] == pytest.approx(0.5)


def test_what_is_no_number_is_left_out_and_said(tmp_path):
    rows = ramp()
    rows[20] = (2290, rows[20][1], "nan", 0, 0, 0, 0, -10)
    rows[30] = (2290, "garbage", 30, 0, 0, 0, 0, -10)
    rows[40] = (2290, rows[40][1], 40)
    path = rows_of(tmp_path / "imu.csv", rows)
    log, got = read({"file": str(path)} | RATES)
    kept = np.setdiff1d(np.arange(1, 200), [20, 30, 40])
    np.testing.assert_allclose(got.dtheta_b_rad[1:, 0], kept * 0.01, rtol=1e-6)
    bad, gaps = log.faults
    assert bad == f"{path}:22: rows that are not six numbers and a time left out: 3"
    assert gaps == f"{path}:23: gaps of up to 1 s: 3, 0.030 s in all"


def test_duplicates_go_and_time_that_goes_back_is_refused(tmp_path):
    rows = ramp()
    path = rows_of(tmp_path / "imu.csv", [*rows[:50], rows[49], *rows[50:]])
    log, got = read({"file": str(path)} | RATES)
    assert got.dt_s.size == 200
    assert list(log.faults) == [f"{path}:52: rows with the time of the row before left out: 1"]
    rows_of(path, rows[:50] + rows[30:])
    with pytest.raises(InputFileError, match=r"imu\.csv:52: time goes back by 0\.19"):
        read({"file": str(path)} | RATES)


# --- NovAtel -------------------------------------------------------------------------------------

# A log of a NovAtel SPAN receiver with an HG1700, published by its owners.
REAL_LOG = (
    "%RAWIMUSA,1537,361705.645;1537,361705.644826900,00000000,30387,415,-5398,"
    "-23039,-18100736,-5117*c01b540c"
)


def test_checksum_of_a_real_log():
    body, _, check = REAL_LOG[1:].partition("*")
    assert f"{crc32(body.encode()):08x}" == check


def test_counts_axes_and_signs_of_novatel(tmp_path):
    path = tmp_path / "imu.asc"
    body = (
        "RAWIMUA,COM1,0,77.0,FINE,2290,100.0,00000020,0000,0;2290,100.{},00000000,10,-20,30,-4,5,6"
    )
    lines = []
    for k in range(3):
        text = body.format(k)
        lines.append(f"#{text}*{crc32(text.encode()):08x}\r\n")
    path.write_text("#BESTPOSA,whatever\r\n" + "".join(lines), newline="")
    keys = {"file": str(path), "format": "novatel_rawimu", "model": "HG1700-AG58"}
    log, got = read(keys)
    foot, count = 0.3048 * 2.0**-27, 2.0**-33
    np.testing.assert_allclose(got.dv_b_mps[1], np.array([30, 20, 10]) * foot)
    np.testing.assert_allclose(got.dtheta_b_rad[1], np.array([6, -5, -4]) * count)
    _, vehicle = read(keys | {"axes": "RFU"})
    np.testing.assert_allclose(vehicle.dv_b_mps[1], np.array([20, 30, -10]) * foot)
    assert list(log.faults) == []
    spoiled = path.read_text().replace("100.1,0", "100.1,1")
    path.write_text(spoiled)
    log, got = read(keys)
    assert got.dt_s.size == 2
    assert next(iter(log.faults)).startswith(f"{path}:3: logs cut short or with a wrong checksum")


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "keys", "cause"),
    [
        ("", {}, "holds no data"),
        ("1,2,3,4,5,6,7\n2,2,3,4,5,6,7\n", {}, "header"),
        ("tow,gx,gy,gz,ax,ay,az\n1,2,3,4,5,6,7,8\n", {}, "rows of 8 fields, the header names 7"),
        ("tow,gx,gy,gz,ax,ay\n1,2,3,4,5,6\n", {}, "accel_z"),
        ("tow,gx,gy,gz,ax,ay,az,gyro_x\n1,2,3,4,5,6,7,8\n", {}, "two columns"),
        ("tow,gyro_x_degps,gy,gz,ax,ay,az\n1,2,3,4,5,6,7\n", {}, r"deg/s.*units\.gyro: rad"),
        ("tow,gx,gy,gz,ax,ay,az\na,b,c,d,e,f,g\n", {}, "wrong columns"),
        ("tow,gx,gy,gz,ax,ay,az\n1,2,3,4,5,6,7\n", {}, "no two rows"),
        ("tow,gx,gy,gz,ax,ay,az\n1e9,2,3,4,5,6,7\n2e9,2,3,4,5,6,7\n", {}, "tick"),
        ("%RAWIMUSA,nonsense\n", {"format": "novatel_rawimu", "model": "FSAS"}, "RAWIMUSA log"),
        ("no HDF5", {"format": "hdf5"}, "HDF5"),
    ],
)
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, text, keys, cause):
    path = tmp_path / "imu.log"
    path.write_text(text)
    with pytest.raises(DeepGnssError, match=cause) as refused:
        read({"file": str(path)} | keys)
    assert str(path) in str(refused.value) and "\n" not in str(refused.value)


def test_settings_that_contradict_each_other(tmp_path):
    for keys in (
        {"format": "kfgins", "kind": "rates", "units": {"gyro": "rad/s", "accel": "m/s^2"}},
        {"format": "novatel_rawimu"},
        {"format": "csv", "model": "FSAS"},
        {"format": "kfgins", "units": {"gyro": "deg"}},
    ):
        with pytest.raises(ValidationError):
            ImuConfig.model_validate({"file": "imu.txt"} | keys)
    with pytest.raises(ConfigError, match="increments only"):
        ImuWriter(tmp_path / "x", "kfgins", "rates")
    with pytest.raises(ConfigError, match="model"):
        ImuWriter(tmp_path / "x", "novatel_rawimu")


def test_a_table_says_its_kind_and_units(tmp_path):
    path = tmp_path / "imu.h5"
    keys = write(path, drive(10), "hdf5", "rates", cut=5)
    wrong = keys | {"kind": "increments", "units": {"gyro": "rad", "accel": "m/s"}}
    with pytest.raises(InputFileError, match=r"kind: rates.*imu\.kind: increments"):
        read(wrong)


def test_a_table_of_words_is_refused(tmp_path):
    path = tmp_path / "imu.h5"
    names = ("gps_tow_s", *(f"{sensor}_{x}" for sensor in ("gyro", "accel") for x in "xyz"))
    with ContainerWriter(path) as container:
        container.add_table("imu", {name: np.array([b"one", b"two"]) for name in names})
    with pytest.raises(InputFileError, match=r"imu\.h5"):
        read({"file": str(path), "format": "hdf5"})


# --- logs none of us wrote -----------------------------------------------------------------------


def test_the_independent_drive(shared_data):
    log, got = read({"file": str(shared_data / "independent/drive/imu.csv")})
    assert got.time_s.size == 12_500 and log.rate_hz == pytest.approx(200.0)
    assert got.origin == GpsTime(2190, 561_628.0) and list(log.faults) == []
    up = -got.dv_b_mps[:, 2].sum() / got.dt_s.sum()
    assert up == pytest.approx(9.8, abs=0.1)


COLUMNS = ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "tick"]


@pytest.mark.parametrize(
    ("name", "rows", "rate_hz", "seconds"),
    [("imu_1934", 54_860, 100.0, 548.6), ("imu_1730", 20_455, 152.3, 134.25)],
)
def test_real_drives_by_their_time_tags(shared_data, name, rows, rate_hz, seconds):
    folder = shared_data / "real/imu/rtklibexplorer-drive"
    keys = {
        "file": str(folder / f"{name}.csv"),
        "columns": COLUMNS,
        "kind": "rates",
        "units": {"gyro": "deg/s", "accel": "g"},
        "time": "tick",
        "tick": 1e-3,
        "tag_file": str(folder / f"{name}.csv.tag"),
        "axes": "FLU",
    }
    log, got = read(keys)
    assert got.time_s.size == rows and log.outages == []
    assert log.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    assert got.time_s[-1] - got.time_s[0] == pytest.approx(seconds, abs=0.2)
    assert 0.0 < got.time_s[0] < 1.0  # s after the log was opened
    assert (np.diff(got.time_s) > 0.0).all()
    force = got.dv_b_mps.sum(axis=0) / got.dt_s.sum()
    assert np.linalg.norm(force) == pytest.approx(9.9, abs=0.15)
    assert force[2] < -9.5  # gravity is borne upwards
