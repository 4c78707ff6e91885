"""The configuration: defaults, refusals with the key's name, overrides, round trips."""

import datetime
import json
import math
import re
from pathlib import Path

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from deepgnss.core.errors import ConfigError
from deepgnss.io.config import (
    Config,
    json_schema,
    load_config,
    notes,
    oscillator_names,
    reference_markdown,
    resolved_yaml,
)
from deepgnss.io.config.text import parse_value

EXAMPLE = Path(__file__).resolve().parents[2] / "configs" / "car.yaml"
MINIMAL = "recording:\n  streams:\n    - {format: int8, sample_rate: 4e6}\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "car.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, *settings: str, text: str = MINIMAL) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_config(write(folder, text), settings)
    return str(caught.value).splitlines()


# --- what is accepted ----------------------------------------------------------------------------


def test_minimal_file_has_the_documented_defaults(tmp_path):
    config = load_config(write(tmp_path, MINIMAL))
    example = load_config(EXAMPLE, check_files=False)
    assert config.recording.streams[0].stream_format().sample_rate_hz == 4e6
    assert config.output.directory == tmp_path / "out"
    assert config.imu is None and config.truth is None
    shared = {"tracking", "positioning", "acquisition", "deep", "oscillator", "signals", "start"}
    assert config.model_dump(include=shared) == example.model_dump(include=shared)
    assert config.recording.streams == example.recording.streams


def test_stream_reaches_the_reader_with_every_key_in_its_place(tmp_path):
    text = """
recording:
  streams:
    - name: A
      format: bits2
      samples: real
      iq_order: qi
      packing: {order: lsb_first, code: levels, levels: [1, 3, -3, -1], word_bytes: 2,
                field: [6, 8]}
      block: {header: 512, payload: 1024, footer: 4}
      channels: {count: 3, index: 2}
      sample_rate: 20.48e6
      centre_frequency: 1.5754e9
      intermediate_frequency: 5499998.474
      spectrum: inverted
      offset: 12
"""
    stream = load_config(write(tmp_path, text)).recording.streams[0].stream_format()
    assert (stream.name, stream.format, stream.samples, stream.iq_order) == (
        "A", "bits2", "real", "qi"
    )  # fmt: skip
    assert (stream.packing.order, stream.packing.code) == ("lsb_first", "levels")
    assert stream.packing.levels == (1, 3, -3, -1)
    assert (stream.packing.word_bytes, stream.packing.field) == (2, (6, 8))
    assert (stream.block.header, stream.block.payload, stream.block.footer) == (512, 1024, 4)
    assert (stream.channels.count, stream.channels.index) == (3, 2)
    assert (stream.sample_rate_hz, stream.centre_hz) == (20.48e6, 1.5754e9)
    assert (stream.intermediate_hz, stream.spectrum, stream.offset) == (5499998.474, "inverted", 12)


def test_deep_may_be_a_switch(tmp_path):
    assert load_config(write(tmp_path, MINIMAL + "deep: false\n")).deep.enabled is False
    assert load_config(write(tmp_path, MINIMAL), ["deep={coupling: tight}"]).deep.enabled is True


def test_paths_start_from_the_file(tmp_path):
    (tmp_path / "brdc.rnx").write_text("x")
    config = load_config(write(tmp_path, MINIMAL + "nav: brdc.rnx\noutput: {directory: a/b}\n"))
    assert config.nav == tmp_path / "brdc.rnx"
    assert config.output.directory == tmp_path / "a" / "b"


def test_start_time_is_utc(tmp_path):
    path = write(tmp_path, MINIMAL)
    noon = datetime.datetime(2023, 5, 12, 12, tzinfo=datetime.UTC)
    for text in ("2023-05-12T12:00:00Z", "2023-05-12 12:00", "2023-05-12T14:00:00+02:00"):
        assert load_config(path, [f"recording.start_time={text}"]).recording.start_time == noon


def test_shipped_oscillators_have_the_stated_coefficients(tmp_path):
    stated = {
        "TCXO": (1e-21, 2e-20),
        "OCXO_K": (2.51e-26, 2.51e-22),
        "TCXO_L": (2e-19, 3e-20),
        "OCXO": (2e-25, 6e-25),
    }
    assert set(oscillator_names()) == set(stated)
    path = write(tmp_path, MINIMAL)
    for name, (h0, h_2) in stated.items():
        oscillator = load_config(path, [f"oscillator={name}"]).oscillator.oscillator()
        assert (oscillator.name, oscillator.h0_s, oscillator.h_2_hz) == (name, h0, h_2)
    own = load_config(path, ["oscillator={h0: 3e-22, h-1: 4e-23, h-2: 5e-24}"]).oscillator
    assert own.oscillator()[1:4] == (3e-22, 4e-23, 5e-24)


def test_resolved_yaml_reads_back_the_same(tmp_path):
    for source in (EXAMPLE, write(tmp_path, MINIMAL)):
        config = load_config(source, ["threads=2"], check_files=False)
        again = tmp_path / "resolved.yaml"
        again.write_text(resolved_yaml(config), encoding="utf-8")
        assert load_config(again, check_files=False) == config


def test_schema_is_json_and_every_key_is_described():
    schema = json.loads(json_schema())
    sections = {"Config": schema} | schema["$defs"]
    bare = [
        f"{name}.{key}"
        for name, section in sections.items()
        for key, field in section.get("properties", {}).items()
        if "description" not in field and "$ref" not in json.dumps(field)
    ]
    assert bare == []
    rate = schema["$defs"]["StreamConfig"]["properties"]["sample_rate"]
    assert (rate["minimum"], rate["maximum"], rate["unit"]) == (1e6, 2e9, "Hz")


# --- YAML 1.2 ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [("4e6", 4e6), ("-1.5E-3", -1.5e-3), (".5", 0.5), ("1575.42e6", 1575.42e6), ("010", 10),
     ("0x10", 16), ("0o17", 15), ("yes", "yes"), ("12:30", "12:30"), ("~", None), ("", None),
     ("true", True), ("-.inf", -math.inf), ("2023-05-12", "2023-05-12"), ("1_000", "1_000")],
)  # fmt: skip
def test_scalars_are_those_of_yaml_1_2(text, value):
    read = parse_value(text, "x")
    assert read == value and type(read) is type(value)


def test_yaml_never_executes(tmp_path):
    lines = refusal(tmp_path, text="nav: !!python/object/apply:os.system ['true']\n")
    assert len(lines) == 1 and "car.yaml:1" in lines[0]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("start: scout\nstart: causal\n", ("'start'", "twice", ":2")),
        ("recording: {streams: [{format: int8, format: int8}]}\n", ("'format'", "twice", ":1")),
        ("recording: [unclosed\n", (":2",)),
        ("- a\n- b\n", ("mapping",)),
        ("? [a]\n: b\n", ("key",)),
        ("[" * 5000, ("nested",)),
        ("nav: \x01\n", ("YAML",)),
    ],
)
def test_broken_text_gives_one_line_with_its_place(tmp_path, text, named):
    (line,) = refusal(tmp_path, text=text)
    assert "car.yaml" in line
    for part in named:
        assert part in line


def test_file_that_cannot_be_read(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
        load_config(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="directory"):
        load_config(tmp_path)
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="UTF-8"):
        load_config(tmp_path / "b.yaml")


# --- what is refused -----------------------------------------------------------------------------

S = "recording.streams[0]"


@pytest.mark.parametrize(
    ("setting", "parts"),
    [
        (f"{S}.sample_rate=4.0", ("4.0", "MHz", "4000000", "1e+06 to 2e+09 Hz")),
        (f"{S}.sample_rate=4000", ("kHz",)),
        (f"{S}.sample_rate='4e6'", ("'4e6'", "number")),
        (f"{S}.sample_rate=true", ("true", "number")),
        (f"{S}.sample_rate=.nan", ("nan", "Hz")),
        (f"{S}.centre_frequency=1575.42", ("MHz", "1.57542e+09")),
        (f"{S}.intermediate_frequency=3e6", ("±2e+06 Hz", "sample_rate")),
        (f"{S}.format=int9", ("'int9'", "'int8'", "bits4")),
        (f"{S}.samples=IQ", ("'IQ'", "'iq'")),
        (f"{S}.packing={{code: levels}}", ("only for bits1",)),
        (f"{S}.channels.index=1", ("found 1",)),
        (f"{S}.offset=-1", ("-1", "bytes")),
        (f"{S}.offset=1.5", ("whole number",)),
        (f"{S}.file=none.bin", ("no such file", "none.bin")),
        (f"{S}.file=.", ("folder",)),
        ("recording.start_time=2023-05-12", ("date and time",)),
        ("recording.start_time=1683860400", ("date and time",)),
        ("recording.start_time=2023-13-12T00:00:00Z", ("date and time",)),
        ("recording.start_time=1923-01-12T00:00:00Z", ("1980",)),
        ("recording.duration=0", ("above 0",)),
        ("signals[0]=GPS_L1", ("GPS_L1CA",)),
        ("signals=[]", ("at least 1",)),
        ("signals=[GPS_L1CA, GPS_L1CA]", ("once",)),
        ("nav=none.rnx", ("none.rnx", "no such file")),
        ("oscillator=XO", ("'XO'", "OCXO", "TCXO_L")),
        ("deep=maybe", ("'maybe'",)),
        ("deep.enabled=yes", ("'yes'", "true or false")),
        ("deep.epoch=100", ("0.01 to 1 s", "ms", "0.1")),
        ("tracking.carrier.long_update.update=0.5", ("0.05 to 0.4 s",)),
        ("tracking.carrier.loop=pll4", ("'kalman' or 'long_update'",)),
        ("tracking.carrier.kalman.fading=0.9", ("1 to 1.5",)),
        ("tracking.carrier.bandwidth=21", ("0.4", "20 Hz")),
        ("tracking.carrier.coherent=0.003", ("0.004",)),
        ("tracking.carrier.coherent=20", ("ms", "0.02")),
        ("tracking.code.bandwidth=[0.1, 1.0]", ("falling",)),
        ("tracking.code.bandwidth=[5, 4, 3, 2, 1]", ("at most 4",)),
        ("tracking.code.spacing=2", ("0.02 to 1 chips",)),
        ("tracking.thresholds.frequency=30", ("28 dB-Hz",)),
        ("tracking.frequency.bins=4", ("odd number",)),
        ("tracking.frequency.window=320", ("0.064 to 0.512 s", "0.32")),
        ("tracking.frequency.discriminator=sftt", ("psfft",)),
        ("tracking.frequency.gain=0", ("above 0",)),
        ("positioning.elevation_mask=95", ("0 to 89 deg",)),
        ("positioning.elevation_mask=0.1745", ("radians",)),
        ("positioning.outliers.alpha=0", ("above 0",)),
        ("positioning.raim=1", ("true or false",)),
        ("output.interval=0.011", ("0.02 to 3600",)),
        ("output.interval=0.11", ("divide a week",)),
        ("threads=0", ("1 to 1024",)),
        ("acquisition.coherent=0.0015", ("whole number of ms",)),
        ("acquisition.false_alarm=2", ("0.1",)),
    ],
)  # fmt: skip
def test_refusals_name_key_value_and_what_would_fit(tmp_path, setting, parts):
    (line,) = refusal(tmp_path, setting)
    assert line.startswith("--set")
    key = setting.partition("=")[0]
    assert key.removesuffix("[0]") in line
    for part in parts:
        assert part in line


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("position: [97.0, 8.0, 10.0]\n", ("position[0]", "97.0", "-90 to 90 deg")),
        ("position: [7.0, 8.0]\n", ("position[2]", "missing")),
        ("imu: {}\n", ("imu.file", "log")),
        ("imu: {format: hdf5, axes: FRG}\n", ("imu.axes", "'FRG'", "FRD")),
        ("imu: {format: hdf5, kind: rates}\n", ("imu.units.gyro", "rates")),
        ("imu: {format: hdf5, time: tick}\n", ("imu.tick",)),
        ("imu: {format: hdf5, time_offset: soon}\n", ("imu.time_offset", "'auto'", "number")),
        ("imu: {format: hdf5, alignment: {method: config}}\n", ("imu.alignment.roll",)),
        ("imu: {format: hdf5, lever_arm: [1, 2, 300]}\n", ("imu.lever_arm[2]", "-100 to 100 m")),
        ("truth: {format: csv}\n", ("truth.file", "missing", "reference")),
        ("oscillator: {h0: 1e-21}\n", ("oscillator.h-2", "missing", "Hz")),
    ],
)
def test_refusals_in_the_file_give_its_line(tmp_path, text, parts):
    (line,) = refusal(tmp_path, text=MINIMAL + text)
    assert "car.yaml:4: " in line
    for part in parts:
        assert part in line


def test_missing_key_says_what_would_fit(tmp_path):
    lines = refusal(tmp_path, text="recording: {streams: [{name: L1}]}\n")
    assert len(lines) == 2
    assert f"{S}.format: missing" in lines[0] and "int16" in lines[0]
    assert f"{S}.sample_rate: missing" in lines[1] and "1e+06 to 2e+09 Hz" in lines[1]


def test_band_without_a_signal_is_refused(tmp_path):
    (line,) = refusal(tmp_path, f"{S}.centre_frequency=1268.52e6")
    assert f"{S}.centre_frequency" in line and "1575.42 MHz" in line


def test_band_is_mirrored_when_the_spectrum_is(tmp_path):
    # 1.5 MHz off centre: inside one half of the band, outside of the other
    path = write(tmp_path, MINIMAL)
    shifted = [f"{S}.centre_frequency=1573.92e6", f"{S}.intermediate_frequency=-1e6"]
    assert load_config(path, shifted).covers("GPS_L1CA")
    with pytest.raises(ConfigError, match="centre_frequency"):
        load_config(path, [*shifted, f"{S}.spectrum=inverted"])


def test_band_pass_sampling_is_refused_with_the_place_it_folds_to(tmp_path):
    rate = [f"{S}.samples=real", f"{S}.sample_rate=10e6"]
    (line,) = refusal(tmp_path, *rate, f"{S}.intermediate_frequency=23e6")
    assert "3000000 Hz, spectrum upright" in line
    (line,) = refusal(tmp_path, *rate, f"{S}.intermediate_frequency=27e6")
    assert "3000000 Hz, spectrum inverted" in line


def test_two_streams_of_one_name(tmp_path):
    (line,) = refusal(tmp_path, f"{S[:-3]}[1]={{format: int8, sample_rate: 4e6}}")
    assert "recording.streams[1].name" in line


def test_unknown_keys_are_guessed(tmp_path):
    for setting, guess in (
        (f"{S}.sample_rat=4e6", "did you mean 'sample_rate'"),
        ("tracking.carrier.bandwith=4", "did you mean 'bandwidth'"),
        ("Tracking={}", "did you mean 'tracking'"),
        ("elevation_mask=3", "belongs under 'positioning'"),
        ("tracking.zzz=3", "known here: carrier, code, frequency, thresholds"),
    ):
        (line,) = refusal(tmp_path, setting)
        assert setting.partition("=")[0] + ": unknown key" in line and guess in line


@pytest.mark.parametrize(
    "setting", ["a b=3", "tracking", "=3", "recording.streams[3].name=x", "a..b=1"]
)
def test_bad_settings(tmp_path, setting):
    (line,) = refusal(tmp_path, setting)
    assert line.startswith(f"--set {setting}: ")


# --- properties over the whole schema ------------------------------------------------------------


def leaf_keys(value: object, above: str = "") -> list[str]:
    if isinstance(value, dict):
        return [k for key, v in value.items() for k in leaf_keys(v, f"{above}.{key}".lstrip("."))]
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [k for place, v in enumerate(value) for k in leaf_keys(v, f"{above}[{place}]")]
    return [above]


FULL = load_config(EXAMPLE, check_files=False)
KEYS = leaf_keys(FULL.model_dump(mode="json", by_alias=True))


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file that gives every key."""
    return write(tmp_path_factory.mktemp("full"), resolved_yaml(FULL))


@given(st.sampled_from(KEYS), st.sampled_from(["{1: {}}", "[[[]]]", "-.inf", ".nan"]))
@settings(deadline=None, derandomize=True, max_examples=200)
def test_nonsense_is_refused_in_one_line_that_names_its_key(full, key, nonsense):
    with pytest.raises(ConfigError) as caught:
        load_config(full, [f"{key}={nonsense}"], check_files=False)
    lines = str(caught.value).splitlines()
    assert lines and all(key in line for line in lines)


@given(st.sampled_from(KEYS), st.text("abcdefgh_", min_size=1, max_size=8))
@settings(deadline=None, derandomize=True, max_examples=60)
def test_unknown_keys_are_refused_everywhere(full, key, extra):
    unknown = f"{key.rpartition('.')[0]}.zz{extra}".lstrip(".")
    with pytest.raises(ConfigError) as caught:
        load_config(full, [f"{unknown}=1"], check_files=False)
    assert f"--set: {unknown}: unknown key" in str(caught.value)


@given(st.floats(0.1, 200.0), st.sampled_from([0.001, 0.002, 0.004, 0.005, 0.010, 0.020]))
@settings(deadline=None, derandomize=True)
def test_loops_are_taken_as_asked_or_refused_never_changed(bandwidth, coherent):
    asked = [f"tracking.carrier.bandwidth={bandwidth}", f"tracking.carrier.coherent={coherent}"]
    if bandwidth * coherent <= 0.4:
        carrier = load_config(None, asked).tracking.carrier
        assert (carrier.bandwidth, carrier.coherent) == (bandwidth, coherent)
    else:
        with pytest.raises(ConfigError, match=r"tracking\.carrier\.bandwidth"):
            load_config(None, asked)


# --- notes ---------------------------------------------------------------------------------------


def test_what_has_no_effect_is_said(tmp_path):
    assert notes(load_config(write(tmp_path, MINIMAL))) == ()
    asked = notes(load_config(EXAMPLE, check_files=False))
    assert any("BDS_B1I" in line for line in asked)
    tight = notes(load_config(EXAMPLE, ["deep.coupling=tight"], check_files=False))
    assert any(line.startswith("deep.coupling: tight") for line in tight)
    wide = load_config(write(tmp_path, MINIMAL), [f"{S}.sample_rate=40e6"])
    assert notes(wide) == ()


def test_config_is_frozen():
    with pytest.raises(ValueError, match="frozen"):
        Config().threads = 3


# --- the reference page --------------------------------------------------------------------------


def test_reference_page_is_in_step_with_the_schema():
    page = EXAMPLE.parents[1] / "docs" / "config.md"
    assert page.read_text(encoding="utf-8") == reference_markdown(), "run `make docs`"


def test_example_gives_every_key_of_the_reference():
    given = yaml_keys(EXAMPLE.read_text(encoding="utf-8"))
    optional = {"name", "h0", "h-1", "h-2", "g_sensitivity", "scale", "columns"}
    optional |= {"tick", "start", "tag_file", "roll", "pitch", "yaw", "model", "rate"}
    optional |= {"gyro", "accelerometer", "bias", "drift", "drift_time", "noise"}  # of a grade
    optional |= {"initial", "velocity", "tilt", "heading"}
    listed = set(re.findall(r"^\| `([\w-]+)`", reference_markdown(), re.MULTILINE))
    assert listed - given <= optional


def yaml_keys(text: str) -> set[str]:
    return set(re.findall(r"([\w-]+):(?= |\n)", re.sub(r"#.*", "", text)))
