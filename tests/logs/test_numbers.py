"""The numbers of logs are those of the page of numbers, and their defaults those of the docstrings."""

import pytest

from tests.numbers_page import misses, modules_with_numbers
from tests.stated_defaults import modules_of, untrue_defaults


@pytest.mark.parametrize("module", modules_with_numbers("skat.logs"))
def test_numbers_of_a_module_are_those_of_the_page(module):
    assert not misses(module)


@pytest.mark.parametrize("module", modules_of("skat.logs"))
def test_defaults_are_those_of_the_docstrings(module):
    assert not untrue_defaults(module)
