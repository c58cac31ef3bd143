"""Mechanisms of the tracer: each can be switched off, is on the page, and is needed.

No time is tested.
"""

import pytest

from reference.command import REFERENCE_FOLDER
from reference.mechanisms import MECHANISMS, Mechanism, compute_gains, remove_mechanism

EACH_MECHANISM = pytest.mark.parametrize("mechanism", MECHANISMS, ids=lambda each: each.name)


@EACH_MECHANISM
def test_each_mechanism_can_be_switched_off(mechanism: Mechanism) -> None:
    compile(remove_mechanism(mechanism), mechanism.module, "exec")


def test_a_text_that_does_not_occur_once_is_an_error() -> None:
    for text in ("no such text", "import"):
        with pytest.raises(ValueError, match=r"not once in antialias/refine\.py"):
            remove_mechanism(MECHANISMS[0]._replace(module="antialias/refine.py", text=text))


def test_the_page_lists_every_mechanism() -> None:
    page = (REFERENCE_FOLDER / "mechanisms.md").read_text(encoding="utf-8")
    rows = [line[2:].split(" | ")[0] for line in page.splitlines() if line.startswith("| ")]
    assert rows[2:] == [mechanism.name for mechanism in MECHANISMS]


@pytest.mark.slow
@EACH_MECHANISM
def test_each_mechanism_is_needed(mechanism: Mechanism) -> None:
    gains = compute_gains(mechanism, rounds=1)
    assert gains.test_ratio >= mechanism.min_test_ratio
    assert gains.error_ratio >= mechanism.min_error_ratio
    if not (mechanism.min_error_ratio or mechanism.module.startswith("antialias/")):
        assert gains.error_ratio == 1  # the mechanism changes no pixel
