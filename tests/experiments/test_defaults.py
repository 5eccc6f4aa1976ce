"""The defaults that docstrings state are those of the signatures."""

import pytest

from tests.stated_defaults import modules_of, untrue_defaults


@pytest.mark.parametrize("module", modules_of("skat.experiments"))
def test_defaults_are_those_of_the_docstrings(module):
    assert not untrue_defaults(module)
