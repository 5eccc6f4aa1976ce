"""The numbers of simulators are those of the page of numbers, and their defaults those of the docstrings."""

import pytest

from skat.simulators import MujocoSimulator, make_simulator
from tests.machines import FINGER, ROLLER, SERVO_ARM
from tests.numbers_page import misses, modules_with_numbers, number, tables
from tests.stated_defaults import modules_of, untrue_defaults


@pytest.mark.parametrize("module", modules_with_numbers("skat.simulators"))
def test_numbers_of_a_module_are_those_of_the_page(module):
    assert not misses(module)


def test_bounds_that_every_model_has_are_those_of_the_page():
    page = {family: number(bounds) for family, bounds, *_ in tables()["bounds"]}
    code = {}
    for machine in (make_simulator("hopper"), *map(MujocoSimulator, (ROLLER, FINGER, SERVO_ARM))):
        for effect in machine.effects(also="all"):
            if effect.family in page and not (effect.target or "").startswith("ctrl."):
                code.setdefault(effect.family, set()).add(effect.bounds)
    assert {family: {bounds} for family, bounds in page.items()} == code, (
        "docs/numbers.rst, bounds: write there what is meant"
    )


@pytest.mark.parametrize("module", modules_of("skat.simulators"))
def test_defaults_are_those_of_the_docstrings(module):
    assert not untrue_defaults(module)
