"""Let a notebook show a scene as its picture, although scenes know nothing of rendering.

`tracer/__init__.py` sets `make_scene_png`, and `Scene` calls it.  This module must not import
NumPy, because `import tracer` imports this module.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

make_scene_png: Callable[[Any], bytes]
"""Renders a `Scene` to the bytes of a PNG file that a notebook can show."""
