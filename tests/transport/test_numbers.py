"""The numbers of transport are those of the page of numbers, and its defaults those of the docstrings."""

import pytest

from tests.numbers_page import misses, modules_with_numbers
from tests.stated_defaults import modules_of, untrue_defaults

PACKAGES = ("skat.gaussian", "skat.transport", "skat.metrics")


@pytest.mark.parametrize("module", [name for package in PACKAGES for name in modules_with_numbers(package)])
def test_numbers_of_a_module_are_those_of_the_page(module):
    assert not misses(module)


@pytest.mark.parametrize("module", [name for package in PACKAGES for name in modules_of(package)])
def test_defaults_are_those_of_the_docstrings(module):
    assert not untrue_defaults(module)
