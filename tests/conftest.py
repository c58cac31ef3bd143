"""What several test files share."""

from __future__ import annotations

import pytest

from tracer import reader


@pytest.fixture(params=["small", "large"])
def either_reader(request, monkeypatch):
    """All files are read as small ones are, or as large ones."""
    monkeypatch.setattr(reader, "_LARGE", {"small": reader.MAX_BYTES, "large": 0}[request.param])
