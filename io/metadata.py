"""What a recording says about itself, whichever of the metadata formats it comes with."""

from __future__ import annotations

from pathlib import Path

from deepgnss.io.container import read_container
from deepgnss.io.formats import RecordingDescription
from deepgnss.io.ion_metadata import read_ion_metadata
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
