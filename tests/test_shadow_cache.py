"""Shadow caches: with what looks nearby have found, samples are as dark as without."""

from __future__ import annotations

import numpy as np
import pytest
from random_scenes import KINDS, random_scene

from tracer import render
from tracer.arrays import Bools
from tracer.shadow.occlusion import Shadows
from tracer.shadow.shadow_cache import ShadowCache
from tracer.view.hits import Hits


# Stretches remember nothing.
@pytest.mark.usefixtures("pixels_are_split", "all_by_light_buffers")
@pytest.mark.parametrize("kind", KINDS)
def test_what_looks_have_found_is_as_dark_as_what_they_have_not(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    known, blocked = 0, Shadows.blocked

    def compared(self: Shadows, hits: Hits, facing: Bools) -> Bools:
        nonlocal known
        cached = blocked(self, hits, facing)
        if isinstance(self.finder, ShadowCache):
            known += hits.own.size
            afresh = blocked(self._replace(finder=self.finder.finder), hits, facing)
            assert np.array_equal(cached[facing], afresh[facing])
        return cached

    monkeypatch.setattr(Shadows, "blocked", compared)
    for seed in range(6):
        render(random_scene(kind, seed, 48, 32), samples=16, processes=1)
    assert known
