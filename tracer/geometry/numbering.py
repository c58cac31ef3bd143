"""Numbering of objects.

An object has up to four numbers, all from 0:

- `object_index`, everywhere in the tracer: its row in the arrays of `Surfaces`.  They contain one
  kind of surface after the other, in the order of `Surfaces.tables`.
- `sphere_index`, `box_index`: its row among the objects of its kind.  Only the modules of shapes
  use this number, because their arrays contain one kind only; `ObjectRange` converts to it.
- `file_index`: its place in the scene file.  Of several surfaces at the same distance, the one with
  the smallest `file_index` is visible.  `Surfaces` as a sequence, and all that users see, has this
  order.
- `shader_index`: its shader, which several objects may share.
"""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import NamedTuple

import numpy as np

from tracer.arrays import Bools, Ints
from tracer.scene.model import Kind, Surfaces


class ObjectRange(NamedTuple):
    """The consecutive object indices of all objects of one kind."""

    start: int
    size: int

    @property
    def slice(self) -> slice:
        """Slice of these objects in an array of all objects."""
        return slice(self.start, self.start + self.size)

    def list_indices(self) -> Shaped[Ints, "size"]:
        return np.arange(self.start, self.start + self.size)

    def contains(self, object_index: Shaped[Ints, "n"]) -> Shaped[Bools, "n"]:
        return (object_index >= self.start) & (object_index < self.start + self.size)

    def to_local(self, object_index: Shaped[Ints, "n"]) -> Shaped[Ints, "n"]:
        """Convert object indices of this kind to rows among the objects of the kind.

        The result may be `object_index` itself.
        """
        return object_index - self.start if self.start else object_index


def get_object_range(surfaces: Surfaces, kind: Kind) -> ObjectRange:
    """Compute the range of all objects of one kind; it is empty if the scene has none."""
    kinds = list(surfaces.counts)
    earlier_kinds = kinds[: kinds.index(kind)]
    start = sum(surfaces.counts[earlier_kind] for earlier_kind in earlier_kinds)
    return ObjectRange(start=start, size=surfaces.counts[kind])
