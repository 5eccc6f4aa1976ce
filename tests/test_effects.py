"""Effects: their names, bounds, values and sentences."""

import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skat.effects import FAMILIES, Effect, checked_values
from tests.numbers_page import PAGE, misses
from tests.stated_defaults import untrue_defaults


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


PARTS = {
    "unit": "1",
    "neutral": 1.0,
    "bounds": (0.05, 20.0),
    "apply": lambda spec, value: None,
    "describe": str,
    "typical": 0.3,
    "odds": 0.4,
    "force_share": 0.5,
    "aliases": ("payload[torso]",),
}


@pytest.mark.parametrize("part", PARTS)
def test_only_the_name_is_given_by_position(part):
    with pytest.raises(TypeError):
        Effect("mass[torso]", PARTS[part], **{name: one for name, one in PARTS.items() if name != part})


def test_what_an_effect_does_and_says_is_no_part_of_what_it_is():
    whole = Effect("mass[torso]", **PARTS)
    spoken = {name: one for name, one in PARTS.items() if name not in ("apply", "describe", "aliases")}
    assert Effect("mass[torso]", **spoken) == whole
    assert Effect("mass[torso]", **{**spoken, "typical": 0.2}) != whole
    assert eval(repr(whole)) == effect()
    assert repr(whole).count("=") == 4


def test_a_quantity_without_a_family_is_off_by_a_fifth_or_a_tenth_of_its_range():
    factor, added = effect("zeal"), effect("zeal", unit="N", neutral=0.0, bounds=(-2.0, 6.0))
    assert factor.typical == 0.2
    assert added.typical == pytest.approx((6.0 - -2.0) / 10)
    assert factor.odds == added.odds == 1.0
    assert effect().odds == FAMILIES["mass"].odds


@pytest.mark.parametrize("what", ["typical", "odds"])
@pytest.mark.parametrize("value", [0.0, -0.1, float("inf")])
def test_a_prior_without_a_size_is_refused(what, value):
    with pytest.raises(ValueError, match=f"{what} of .* must be positive and finite"):
        effect(**{what: value})


def test_typical_sizes_are_small_against_what_they_change():
    """A model is rarely off by more than a fifth; of what is added, m, rad and s are small numbers on a robot.

    But for a time step: steps are halved.
    """
    for record in FAMILIES.values():
        if record.name == "timestep":
            assert record.typical == pytest.approx(math.log(2), abs=0.01)
        elif record.neutral == 1.0 and record.typical is not None:
            assert 0 < record.typical <= 0.2, record.name
        elif record.neutral == 0.0 and record.typical is not None:
            assert 0 < record.typical <= 0.1, record.name
        elif record.typical is not None:
            assert record.typical < record.neutral, record.name
        assert record.neutral == 0.0 or record.form in ("", "limit"), record.name
        assert record.force_share is None or 0 < record.force_share < 1, record.name
        assert record.neutral in (0.0, 1.0, 2.0) or record.name == "current_limit"


def test_sticking_is_a_bell_of_the_speed_unless_said_otherwise():
    """Stribeck's exponent of most textbooks: exp(-(v / v_s)^2)."""
    assert FAMILIES["stribeck_exponent"].neutral == 2.0


def test_edits_that_need_the_outcome_of_others_have_a_turn_each_and_memory_comes_last():
    turns = sorted((record.order, record.name) for record in FAMILIES.values() if record.order)
    assert [order for order, _ in turns] == list(range(1, len(turns) + 1))
    assert [name for _, name in turns[-3:]] == ["lag", "delay", "backlash"]
    assert FAMILIES["mass"].order == FAMILIES["length"].order == 0


def test_bounds_belong_to_the_range_whatever_rounding_has_made_of_them():
    both = effect("wind[x]", unit="N", neutral=0.0, bounds=(-5.0, 3.0))
    assert both.checked(-5.0 * (1 + 1e-12)) == -5.0
    assert both.checked(3.0 * (1 + 1e-12)) == 3.0
    for value in (-5.0 - 1e-6, 3.0 + 1e-6):
        with pytest.raises(ValueError, match="out of bounds"):
            both.checked(value)
    for bounds in ((0.0, 1.0), (-1.0, 0.0)):
        one = effect("wind[x]", unit="N", neutral=0.0, bounds=bounds)
        assert [one.checked(value) for value in bounds] == list(bounds)
        assert one.checked(bounds[0] - 1e-17) == bounds[0]


@pytest.mark.parametrize("bounds", [(-float("inf"), 1.0), (0.0, float("inf"))])
def test_endless_bounds_are_refused(bounds):
    with pytest.raises(ValueError, match="must be finite"):
        effect(bounds=bounds)


@pytest.mark.parametrize(
    ("name", "unit", "neutral", "value", "end"),
    [
        ("gain[hip]", "1", 1.0, -0.96, "gain[hip] is inverted"),
        ("gain[hip]", "1", 1.0, -1.04, "gain[hip] is inverted"),
        ("gain[hip]", "1", 1.0, -0.9, "gain[hip] is -0.9 times the model's"),
        ("gain[hip]", "1", 1.0, -0.04, "gain[hip] is disabled"),
        ("gain[hip]", "1", 1.0, 0.06, "gain[hip] is 0.06 times the model's"),
        ("mass[hip]", "1", 1.0, 0.01, "the mass of hip is 0.01 times the model's"),
        (
            "contact_anisotropy[all]",
            "1",
            1.0,
            0.5,
            "the contact friction along its second direction is 0.5 times that along the first",
        ),
        ("centre_of_mass[arm.x]", "m", 0.0, 0.02, "the centre of mass along arm.x is shifted by 0.02 m"),
        ("damping[knee]", "N s/m", 0.0, 0.0, "viscous damping of knee is 0 N s/m more than the model's"),
        ("delay[action]", "s", 0.0, 0.02, "the delay of every action is 0.02 s"),
        ("delay[hip]", "s", 0.0, 0.02, "the delay of hip is 0.02 s"),
        ("bias[ctrl.hip]", "N", 0.0, 0.5, "the bias of the command of hip is 0.5 N"),
        ("bias[qpos.hip]", "rad", 0.0, 0.5, "the bias of sensor qpos.hip is 0.5 rad"),
        ("offset[ctrl.hip]", "N", 0.0, 0.5, "the offset of the command of ctrl.hip is 0.5 N"),
    ],
)
def test_sentences_at_their_edges(name, unit, neutral, value, end):
    assert Effect(name, unit=unit, neutral=neutral, bounds=(-3, 3)).describe(value) == end


def test_meaning_of_all_is_that_of_every_one():
    assert effect("gain[all]").meaning == "the force of every actuator for its command"
    assert effect("gain[hip]").meaning == "the force of the actuator hip for its command"
    assert effect("gravity").meaning != ""


def test_close_names_are_few_and_alike():
    known = [effect(f"mass[leg{number}]") for number in range(9)] + [effect("gravity")]
    with pytest.raises(ValueError, match="unknown effect") as refused:
        checked_values(known, {"mass[leg]": 1.0})
    close = str(refused.value).split("Close names: ")[1].split(". ")[0].split(", ")
    assert len(close) == 4
    assert all(name.startswith("mass[leg") for name in close)
    with pytest.raises(ValueError, match="unknown effect") as refused:
        checked_values(known, {"zz": 1.0})
    assert "Close names" not in str(refused.value)
    assert "Targets of" not in str(refused.value)
    assert checked_values(known, None) == {}


def test_numbers_and_defaults_are_those_of_the_documentation():
    assert not misses("skat.effects")
    assert not untrue_defaults("skat.effects")


def test_the_table_of_priors_is_that_of_the_records():
    table = (PAGE.parent / "simulators.rst").read_text("utf-8").partition(":class: prior-table\n\n")[2]
    lines = table.partition("\n\n")[0].splitlines()
    rows = {name: rest for name, *rest in ([cell.strip() for cell in line.split(",")] for line in lines)}
    assert list(rows) == list(FAMILIES)
    for name, record in FAMILIES.items():
        neutral = "the model's" if math.isnan(record.neutral) else f"{record.neutral:g}"
        typical = "rule" if record.typical is None else f"{record.typical:g}"
        share = "" if record.force_share is None else f"{record.force_share:g}"
        expected = [neutral, "force" if share else typical, share, f"{record.odds:g}", str(record.order)]
        assert rows[name] == expected, f"docs/simulators.rst, {name}: write there what is meant"
