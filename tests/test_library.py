"""What programs that make scenes themselves rely on: checks, copies, comparisons."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import pytest

from tracer import Scene, SceneError, SceneFileError, load_scene

# Every way to copy an object.
COPIES: dict[str, Callable[[Any], Any]] = {
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
    **{
        f"pickle {protocol}": lambda o, p=protocol: pickle.loads(pickle.dumps(o, p))
        for protocol in range(pickle.HIGHEST_PROTOCOL + 1)
    },
}
copied = pytest.mark.parametrize("copy_of", COPIES.values(), ids=COPIES)


@copied
def test_errors_are_copied(copy_of: Callable[[Any], Any]) -> None:
    with pytest.raises(SceneError) as bad:
        Scene(width=0, height=-1)
    same = copy_of(bad.value)
    assert type(same) is SceneError
    assert same.faults == bad.value.faults
    assert len(same.faults) == 2
    assert str(same) == str(bad.value)

    with pytest.raises(SceneFileError) as missing:
        load_scene("missing.xml")
    missing.value.note = "kept"  # type: ignore[attr-defined]
    same = copy_of(missing.value)
    assert type(same) is SceneFileError
    assert (same.lines, str(same)) == (missing.value.lines, str(missing.value))
    assert same.note == "kept"
