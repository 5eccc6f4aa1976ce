"""The numbers of the diagnosis are those of the page of numbers, and its defaults those of the docstrings."""

import pytest

from skat.diagnosis.doubts import DOUBTS
from tests.numbers_page import misses, modules_with_numbers, number, tables
from tests.stated_defaults import modules_of, untrue_defaults


@pytest.mark.parametrize("module", modules_with_numbers("skat.diagnosis", but="skat.diagnosis.report"))
def test_numbers_of_a_module_are_those_of_the_page(module):
    assert not misses(module)


def test_doubts_are_worth_a_warning_or_an_error_where_the_page_says():
    page = {name: (number(warned), number(refused)) for name, warned, refused, *_ in tables()["doubts"]}
    endless = float("inf")
    code = {one.name: (one.threshold, None if one.refused == endless else one.refused) for one in DOUBTS}
    assert page == code, "docs/numbers.rst, doubts: write there what is meant"


@pytest.mark.parametrize("module", modules_of("skat.diagnosis"))
def test_defaults_are_those_of_the_docstrings(module):
    assert not untrue_defaults(module)
