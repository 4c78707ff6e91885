"""Fixtures every room's tests share."""

from pathlib import Path

import pytest

import deepgnss.cli.main  # noqa: F401  (before numpy: one thread of linear algebra, as in a run)

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recordings and logs that none of us wrote; absent on most machines."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no shared recordings at {SHARED_DATA.name} beside the checkout's parent")
    return SHARED_DATA
