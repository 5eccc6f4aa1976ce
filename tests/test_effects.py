"""Effects: their names, bounds, values and sentences."""

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skat.effects import FAMILIES, Effect, checked_values


def effect(name="mass[torso]", **changes):
    return Effect(name, **{"unit": "1", "neutral": 1.0, "bounds": (0.05, 20.0), **changes})


def test_name_splits_into_family_and_target():
    assert (effect().family, effect().target) == ("mass", "torso")
    assert (effect("gravity").family, effect("gravity").target) == ("gravity", None)
    assert effect("bias[qpos.root.x]").target == "qpos.root.x"


@pytest.mark.parametrize("name", ["", "mass[", "mass[]", "[torso]", "mass torso", "mass[a][b]"])
def test_other_names_are_refused(name):
    with pytest.raises(ValueError, match=r"'family' or 'family\[target\]'"):
        effect(name)


@pytest.mark.parametrize("bounds", [(2.0, 3.0), (0.1, 0.5), (1.0, 1.0), (3.0, 0.0)])
def test_bounds_enclose_the_neutral_value(bounds):
    with pytest.raises(ValueError, match="must enclose the neutral value 1"):
        effect(bounds=bounds)


@given(st.floats(0.1, 10), st.floats(0.1, 10))
def test_neutral_value_is_the_identity_of_combination(first, second):
    factor, addition = effect(), effect("wind[x]", neutral=0.0, bounds=(-1.0, 1.0))
    assert factor.combined(first, factor.neutral) == first
    assert addition.combined(first, addition.neutral) == first
    assert factor.combined(first, second) == factor.combined(second, first) == first * second
    assert addition.combined(first, second) == first + second


def test_effect_is_frozen_and_pickles_with_its_sentence():
    copy = pickle.loads(pickle.dumps(effect()))
    assert copy == effect()
    assert copy.describe(2) == effect().describe(2)
    with pytest.raises(AttributeError):
        copy.unit = "kg"


@pytest.mark.parametrize(
    ("name", "unit", "neutral", "value", "sentence"),
    [
        ("mass[torso]", "1", 1.0, 1.08, "the mass of torso is 1.08 times the model's"),
        ("mass[all]", "1", 1.0, 0.5, "the mass of every body is 0.5 times the model's"),
        ("gain[thigh_joint]", "1", 1.0, -1.0, "gain[thigh_joint] is inverted"),
        ("gain[thigh_joint]", "1", 1.0, 0.0, "gain[thigh_joint] is disabled"),
        ("gain[thigh_joint]", "1", 1.0, 0.7, "gain[thigh_joint] is 0.7 times the model's"),
        ("tilt[x]", "rad", 0.0, 0.02, "the ground's slope along x is 0.02 rad"),
        (
            "damping[knee]",
            "N m s/rad",
            0.0,
            -0.25,
            "viscous damping of knee is 0.25 N m s/rad less than the model's",
        ),
        ("kv[knee]", "1", 1.0, 1.5, "the velocity gain (kv) of the servo knee is 1.5 times the model's"),
        ("kv[all]", "1", 1.0, 1.5, "the velocity gain (kv) of every servo is 1.5 times the model's"),
        ("stickiness[floor]", "N", 0.0, 2.0, "stickiness[floor] is 2 N"),
        ("friction", "1", 0.4, 0.62, "friction is 0.62 (the model has 0.4)"),
        ("hinge", "N m", 0.4, 0.62, "hinge is 0.62 N m (the model has 0.4 N m)"),
        ("mass", "1", 1.0, 1.2, "mass is 1.2 times the model's"),
        ("mass", "kg", 1.0, 1.2, "mass is 1.2 kg (the model has 1 kg)"),
        ("damping[slider]", "1/s", 0.3, 0.5, "viscous damping of slider is 0.5 1/s (the model has 0.3 1/s)"),
        ("gain[valve]", "V", 0.0, 0.03, "gain[valve] is 0.03 V"),
        ("wind[x]", "m/s", 0.0, 2.0, "wind[x] is 2 m/s"),
        ("restitution[floor]", "1", 0.5, 0.7, "restitution[floor] is 0.7 (the model has 0.5)"),
        ("inertia[all]", "1", 1.0, 1.2, "inertia[all] is 1.2 times the model's"),
    ],
)
def test_sentences(name, unit, neutral, value, sentence):
    assert Effect(name, unit=unit, neutral=neutral, bounds=(-3, 3)).describe(value) == sentence


def test_own_sentence_wins():
    assert effect(describe=lambda value: f"{value} torsos").describe(2) == "2 torsos"


def test_unknown_name_lists_close_names_and_families():
    known = [effect("mass[torso]"), effect("mass[foot]"), effect("gravity")]
    with pytest.raises(
        ValueError, match=r"unknown effect 'mass\[torsoe\]'. Close names: mass\[torso\].*mass\[...\], gravity"
    ):
        checked_values(known, {"mass[torsoe]": 1.0})
    with pytest.raises(ValueError, match=r"Targets of mass: torso, foot"):
        checked_values(known, {"mass[left upper forearm]": 1.0})


@pytest.mark.parametrize("value", [21.0, 0.0, float("nan"), float("inf")])
def test_value_out_of_bounds_names_the_bounds(value):
    with pytest.raises(ValueError, match=r"mass\[torso\] = .* expected a value from 0.05 to 20"):
        checked_values([effect()], {"mass[torso]": value})


def test_value_must_be_a_number_and_values_a_dictionary():
    with pytest.raises(TypeError, match="must be a number"):
        checked_values([effect()], {"mass[torso]": "heavy"})
    with pytest.raises(TypeError, match="dictionary from names to values"):
        checked_values([effect()], ["mass[torso]"])


def test_values_come_back_in_the_order_of_the_effects():
    known = [effect("gravity"), effect("mass[torso]")]
    assert list(checked_values(known, {"mass[torso]": 2, "gravity": 1})) == ["gravity", "mass[torso]"]


def test_a_quantity_stated_in_full_is_combined_by_what_each_value_adds():
    spring = Effect("spring", unit="N/m", neutral=40.0, bounds=(0.0, 100.0))
    assert not spring.is_factor
    assert spring.combined(50.0, 40.0) == 50.0
    assert spring.combined(50.0, 45.0) == 55.0


def test_no_family_is_likelier_than_what_wears_or_was_never_measured():
    """Masses, gains, dampings and dry friction have odds of one."""
    assert all(0 < record.odds <= 1 for record in FAMILIES.values())
    assert {FAMILIES[name].odds for name in ("mass", "gain", "damping", "dry_friction")} == {1.0}
