"""What a recording says about itself, whichever of the metadata formats it comes with."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from deepgnss.core.errors import RecordingError
from deepgnss.io.container import read_container
from deepgnss.io.formats import RecordingDescription, StreamFormat
from deepgnss.io.ion_metadata import read_ion_metadata
from deepgnss.io.recording import Recording, open_readable
from deepgnss.io.sigmf import read_sigmf

_HDF5 = (".h5", ".hdf5")
_ION = (".sdrx", ".smfx", ".xml")


def describe(path: Path) -> RecordingDescription | None:
    """Description of a recording from its own metadata; None for a file of bare samples.

    `path` may be a metadata file (SigMF, ION), an HDF5 container, or a file of samples beside
    which a metadata file of the same name lies.

    Raises
    ------
    RecordingError
        The metadata are there but cannot be used.
    """
    suffix = path.suffix.lower()
    if suffix in _HDF5:
        return read_container(path)
    if suffix == ".sigmf-meta":
        return read_sigmf(path)
    if suffix in _ION:
        return read_ion_metadata(path)
    beside = path.with_suffix(".sigmf-meta")
    if beside.is_file():
        return read_sigmf(beside)
    for ending in _ION:
        beside = path.with_suffix(ending)
        if beside.is_file():
            return read_ion_metadata(beside, path)
    return None


def open_recording(
    path: Path, streams: Sequence[StreamFormat] = ()
) -> tuple[Recording, RecordingDescription]:
    """Open a recording as the configuration describes it, else as it describes itself.

    Parameters
    ----------
    path: a file of samples, or of metadata. streams: from the configuration; may be empty.

    Raises
    ------
    RecordingError
        It cannot be opened, or nothing says how its samples lie in the file.
    """
    described = RecordingDescription(tuple(streams)) if streams else describe(path)
    if described is None:
        open_readable(path).close()
        raise RecordingError(
            f"{path}: nothing says how its samples lie in the file: a configuration with"
            " recording.streams is needed, or SigMF or ION metadata of the same name beside it"
        )
    return Recording(described.streams, path), described
