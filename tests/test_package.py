"""What `import tracer` gives, and when it is imported."""

from __future__ import annotations

import subprocess
import sys

import pytest

import tracer


def test_what_is_public_is_imported_on_first_use():
    script = """
import sys
import tracer
assert set(tracer.__all__) < set(dir(tracer))
assert "numpy" not in sys.modules
for name in tracer.__all__:
    assert name == "Shader" or getattr(tracer, name).__name__ == name
"""
    subprocess.run([sys.executable, "-c", script], check=True)


def test_what_is_not_there():
    with pytest.raises(AttributeError, match="module 'tracer' has no attribute 'ray'"):
        _ = tracer.ray
