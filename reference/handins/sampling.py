"""Choose pixels at random, always the same ones, so that a few represent a picture."""

from __future__ import annotations

from typing import Annotated as Shaped
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from reference.handins.formula_functions import Array

# Maximum number of items from which items are chosen.  A random subset represents more items.
_MAX_CANDIDATES = 1_000_000

Ints32: TypeAlias = NDArray[np.int32]


def choose_from_strata(strata: Shaped[Array, "n"], max_count: int) -> Shaped[Ints32, "k"]:
    """Choose up to `max_count` items at random, about the same number from each stratum.

    `strata` holds the stratum of each item; the indices of the chosen items are returned.  If there
    are no more than `max_count` items, all are chosen.  `max_count` must not exceed
    `_MAX_CANDIDATES`.
    """
    candidate_index = shuffle_range(len(strata))[:_MAX_CANDIDATES]
    order = np.argsort(strata[candidate_index], kind="stable")
    counts = np.unique(strata[candidate_index], return_counts=True)[1]
    # The first candidate of each stratum has place 0, the second has place 1, and so on.
    place_in_stratum = np.arange(len(order)) - np.repeat(counts.cumsum() - counts, counts)
    return candidate_index[order[np.argsort(place_in_stratum, kind="stable")[:max_count]]]


def shuffle_range(count: int) -> Shaped[Ints32, "count"]:
    """Return the integers from 0 to `count` - 1 in random order, which is always the same."""
    # Arrays of int64 would take too much memory.
    return np.random.default_rng(1).permutation(np.arange(count, dtype=np.int32))
