from pathlib import Path

import pytest

from deepgnss.core.errors import OutputError
from deepgnss.io.output import OutputFile, part_path, write_whole
from deepgnss.io.tracks import KmlTrack


def test_named_part_until_closed(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "folder" / "a.csv"
    file = OutputFile(path)
    file.write("a\n")
    file.flush()
    assert not path.exists()
    assert part_path(path).read_text() == "a\n"
    file.write("b\n")
    file.close()
    file.close()
    assert path.read_text() == "a\nb\n"
    assert not part_path(path).exists()


def test_tail_closes_the_document_at_every_flush_and_stands_once(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    items: list[str] = []
    file = OutputFile(path, lambda: "]" * (1 + (len(items) == 1)))
    file.write("[")
    for item in ("1", ",2", ",3"):
        items.append(item)
        file.write(item)
        file.flush()
        body = "[" + "".join(items)
        assert part_path(path).read_text() == body + ("]]" if len(items) == 1 else "]")
    file.close()
    assert path.read_text() == "[1,2,3]"


def test_exception_leaves_a_readable_part_file(tmp_path: Path) -> None:
    path = tmp_path / "track.kml"
    with pytest.raises(KeyboardInterrupt), KmlTrack(path, "x"):
        raise KeyboardInterrupt
    assert not path.exists()
    assert part_path(path).read_text().endswith("</kml>\n")


def test_older_result_does_not_survive_a_failed_run(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_whole(path, "old")
    OutputFile(path).abandon()
    assert not path.exists()


def test_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"file/a\.csv: cannot write: ") as caught:
        OutputFile(tmp_path / "file" / "a.csv")
    assert "\n" not in str(caught.value)


def test_full_disk_is_one_line(tmp_path: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this system")
    path = tmp_path / "a.csv"
    part_path(path).symlink_to("/dev/full")
    file = OutputFile(path)
    file.write("row\n")
    with pytest.raises(OutputError, match="cannot write: No space left on device"):
        file.close()
    assert not path.exists()


def test_many_rows_reach_the_disk_without_a_flush(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    file = OutputFile(path)
    for k in range(20_000):
        file.write(f"{k:07d}\n")
    text = part_path(path).read_text()
    assert len(text) > 65_536
    assert text.endswith("\n")
    assert len(text) % 8 == 0  # whole records only
    file.close()
    assert path.read_text().split() == [f"{k:07d}" for k in range(20_000)]
