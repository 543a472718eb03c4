"""Stop reasons: every one has a name and a sentence."""

import pytest

from jaxwillmore.evolve import RESULTS, message, name_of

NAMES = (
    "reached_t1",
    "stationary",
    "step_too_small",
    "not_finite",
    "element_inverted",
    "energy_rising",
    "step_limit",
    "interrupted",
)


@pytest.mark.parametrize("name", NAMES)
def test_every_reason_has_a_name_and_a_sentence(name):
    result = getattr(RESULTS, name)
    assert name_of(result) == name
    assert message(result).endswith(".") and len(message(result)) > 20
