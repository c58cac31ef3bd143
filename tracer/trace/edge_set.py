"""A set of shadow edges, of limited size."""

from __future__ import annotations

from typing import Annotated as Shaped

import numpy as np

from tracer.arrays import BATCH_SIZE, Bools, Ints, find_runs, sort_distinct, take_2d

# Maximum number of shadow edges that are collected before duplicates are removed: it limits memory.
_EDGES_PER_BATCH = 8 * BATCH_SIZE

# Maximum number of shadow edges of one light near a hit.  If there are more, some are omitted.
MAX_EDGES_PER_HIT = 64


class EdgeSet:
    """Shadow edges, without duplicates.

    An edge is given by the indices of a light, of a hit, and of an object that casts a shadow of
    this light near the hit.
    """

    # Whether a light has more than `MAX_EDGES_PER_HIT` edges near a hit.  These edges are dropped.
    # Complete only after a call of `get_edges`.
    is_crowded: Shaped[Bools, "lights hits"]

    def __init__(self, light_count: int, hit_count: int, object_count: int) -> None:
        self.is_crowded = np.zeros((light_count, hit_count), dtype=np.bool_)
        self._index_counts = light_count, hit_count, object_count
        # Keys of edges: a key is one integer that encodes the three indices.  The keys in the first
        # batch are distinct and sorted.
        self._key_batches = [np.zeros(0, dtype=np.intp)]

    def add(self, edges: Shaped[Ints, "3 n"]) -> None:
        """Add edges whose light, hit and object are the rows of an array.

        Edges are ignored if they are in the set already, or if their light is known to have too
        many edges near their hit.
        """
        is_kept = ~take_2d(self.is_crowded, edges[0], edges[1])
        keys = np.ravel_multi_index(tuple(edges[:, is_kept]), self._index_counts)
        self._key_batches.append(keys)
        if sum(batch.size for batch in self._key_batches[1:]) > _EDGES_PER_BATCH:
            self._merge_batches()

    def get_edges(self) -> Shaped[Ints, "3 n"]:
        """Return the lights, hits and objects of all edges, sorted by light, hit and object."""
        self._merge_batches()
        return np.array(np.unravel_index(self._key_batches[0], self._index_counts))

    def _merge_batches(self) -> None:
        """Merge all batches of keys without duplicates, and drop the edges of crowded pairs.

        A pair of a light and a hit is crowded if it has more than `MAX_EDGES_PER_HIT` edges.  It is
        marked in `is_crowded`.
        """
        keys = sort_distinct(np.concatenate(self._key_batches))
        object_count = self._index_counts[2]
        pair_key = keys // object_count  # encodes the light and the hit
        pair_start, edge_count = find_runs(pair_key)
        is_pair_crowded = edge_count > MAX_EDGES_PER_HIT
        self.is_crowded.ravel()[pair_key[pair_start[is_pair_crowded]]] = True
        self._key_batches = [keys[~is_pair_crowded.repeat(edge_count)]]
