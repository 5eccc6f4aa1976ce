"""Findings of several logs side by side: what agrees, what differs, and by which p-value."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2, norm

from skat.diagnosis import compare_findings
from skat.diagnosis.report.agreement import agreement_sentences
from skat.diagnosis.report.machine import SCHEMA

DRY = "dry_friction[elbow]"


def cause(name, value, half, unit="N m", **fields):
    """A cause with an interval that is as wide to both sides."""
    interval = [value - half, value + half]
    return {"name": name, "unit": unit, "value": value, "interval": interval, "aliases": [], **fields}


def factor(name, value, ratio):
    """A factor with an interval that is as wide to both sides on the logarithm."""
    return cause(name, value, 0.0, "1") | {"interval": [value / ratio, value * ratio]}


def found(*causes, also=(), **fields):
    verdict = "named" if causes else "nothing detected"
    content = {"schema": SCHEMA, "verdict": verdict, "causes": list(causes), "also_seen": dict(also)}
    return content | fields


def only(table):
    (row,) = table.to_dict("records")
    return row


def test_two_logs_are_compared_by_the_difference_over_its_standard_deviation():
    row = only(compare_findings([found(cause(DRY, 0.10, 0.02)), found(cause(DRY, 0.12, 0.01))]))
    z = 0.02 / np.hypot(0.02 / 1.96, 0.01 / 1.96)
    assert row["chi_square"] == pytest.approx(z**2, rel=1e-12)
    assert row["p_value"] == pytest.approx(2 * norm.sf(z), rel=1e-9)
    assert row["p_corrected"] == row["p_value"]
    assert row["agreement"] == "agree"


def test_logs_of_distant_values_differ_at_the_p_value_of_chi_square():
    values, halves = np.array([0.10, 0.12, 0.20]), np.array([0.01, 0.02, 0.04])
    table = compare_findings([found(cause(DRY, *one)) for one in zip(values, halves)])
    weights = (1.96 / halves) ** 2
    mean = np.average(values, weights=weights)
    square = np.sum(weights * (values - mean) ** 2)
    row = only(table)
    assert row["p_value"] == pytest.approx(chi2.sf(square, 2), rel=1e-9)
    assert row["p_value"] < 1e-4
    assert (row["n_compared"], row["agreement"]) == (3, "differ")
    (sentence,) = agreement_sentences(table)
    assert sentence == f"{DRY}: the logs differ (p = {row['p_value']:.2g})"


def test_a_factor_is_compared_on_the_logarithm_where_its_interval_is_symmetric():
    row = only(
        compare_findings([found(factor("mass[lower]", 1.0, 1.5)), found(factor("mass[lower]", 3.0, 2.0))])
    )
    variance = (np.log(1.5) / 1.96) ** 2 + (np.log(2.0) / 1.96) ** 2
    assert row["chi_square"] == pytest.approx(np.log(3) ** 2 / variance, rel=1e-9)


def test_a_number_without_unit_is_compared_as_it_is_where_its_interval_is_symmetric_there():
    logs = [found(cause("load_friction[elbow]", value, 0.09, "1")) for value in (0.1, 0.3)]
    assert only(compare_findings(logs))["chi_square"] == pytest.approx(2 * (0.1 / 0.09 * 1.96) ** 2, rel=1e-9)


def test_a_gain_that_is_inverted_in_a_log_is_compared_as_it_is():
    logs = [found(cause("gain[elbow]", value, 0.1, "1")) for value in (-1.0, 1.0)]
    assert only(compare_findings(logs))["chi_square"] == pytest.approx(2 * (1.0 / 0.1 * 1.96) ** 2, rel=1e-9)


def test_an_interval_that_a_bound_has_cut_counts_by_its_longer_side():
    whole = [found(cause(DRY, 0.01, 0.05)), found(cause(DRY, 0.1, 0.02))]
    cut = [found(cause(DRY, 0.01, 0.05) | {"interval": [0.0, 0.06]}), whole[1]]
    assert only(compare_findings(cut))["chi_square"] == pytest.approx(
        only(compare_findings(whole))["chi_square"]
    )


@given(
    values=st.lists(st.floats(0.5, 2.0), min_size=2, max_size=5),
    scale=st.sampled_from([1e-3, 0.5, 200.0]),
    turn=st.randoms(use_true_random=False),
)
def test_order_of_logs_and_size_of_the_unit_change_nothing(values, scale, turn):
    first = only(compare_findings([found(cause(DRY, one, 0.1 * one)) for one in values]))
    turn.shuffle(values)
    again = only(compare_findings([found(cause(DRY, scale * one, 0.1 * scale * one)) for one in values]))
    assert again["chi_square"] == pytest.approx(first["chi_square"], rel=1e-9, abs=1e-9)


@given(values=st.lists(st.floats(0.2, 5.0), min_size=2, max_size=5), ratio=st.floats(1.05, 3.0))
def test_factors_agree_as_much_as_their_reciprocals(values, ratio):
    logs, turned = ([found(factor("mass[lower]", one**power, ratio)) for one in values] for power in (1, -1))
    assert only(compare_findings(logs))["chi_square"] == pytest.approx(
        only(compare_findings(turned))["chi_square"], rel=1e-9, abs=1e-9
    )


def test_several_causes_are_corrected_as_holm_does():
    p_values = {"mass[a]": 0.004, "mass[b]": 0.03, "mass[c]": 0.02}
    apart = {name: np.sqrt(2) * norm.isf(p / 2) / 1.96 for name, p in p_values.items()}
    logs = [found(*(cause(name, 5 + n * size, 1.0, "kg") for name, size in apart.items())) for n in (0, 1)]
    table = compare_findings(logs).set_index("cause")
    assert table["p_value"].to_dict() == pytest.approx(p_values, rel=1e-9)
    # 3 x .004; 2 x .02; the last is no smaller than the one before.
    assert table["p_corrected"].to_dict() == pytest.approx(
        {"mass[a]": 0.012, "mass[b]": 0.04, "mass[c]": 0.04}, rel=1e-9
    )
    assert set(table["agreement"]) == {"agree"}
    first = agreement_sentences(table.reset_index())[0]
    assert first == "mass[a]: the logs agree (p = 0.004, corrected for all that was compared p = 0.012)"


def test_logs_of_the_same_values_are_said_to_differ_in_one_of_a_hundred_comparisons():
    rng = np.random.default_rng(0)
    wrong = 0
    for _ in range(500):
        logs = [
            found(
                *(
                    cause(f"bias[{n}]", 1 + half / 1.96 * rng.normal(), half, "m")
                    for n, half in enumerate((0.1, 2.0, 0.5))
                )
            )
            for _ in range(3)
        ]
        wrong += (compare_findings(logs)["agreement"] == "differ").any()
    # 5 of 500 with a standard deviation of 2.2.
    assert 1 <= wrong <= 12


def test_a_cause_that_a_log_does_not_name_is_looked_for_among_aliases_and_what_was_also_seen():
    alias = [{"name": DRY, "probability": 0.3}]
    logs = {
        "june": found(cause(DRY, 0.1, 0.02), cause("mass[lower]", 2.0, 0.1, "1")),
        "july": found(cause(DRY, 0.11, 0.02)),
        "august": found(cause("damping[elbow]", 0.3, 0.1, "N m s/rad", aliases=alias)),
        "may": found(also={DRY: 0.05}),
    }
    table = compare_findings(logs).set_index("cause")
    assert list(table.index) == [DRY, "mass[lower]", "damping[elbow]"]
    row = table.loc[DRY]
    assert [row[f"status in {name}"] for name in logs] == [
        "named",
        "named",
        "alias of damping[elbow]",
        "also seen",
    ]
    assert (row["value in may"], row["n_compared"], row["agreement"]) == (0.05, 2, "agree")
    assert np.isnan(row["value in august"])
    friction, mass, damping = agreement_sentences(table.reset_index())
    assert friction.startswith(f"{DRY}: june and july agree (p = ")
    assert friction.endswith("); alias of damping[elbow] in august; also seen in may")
    assert mass == "mass[lower]: named in june alone"
    assert damping == "damping[elbow]: named in august alone"


@pytest.mark.parametrize(
    ("fields", "status"),
    [
        ({"at_bound": True}, "at a bound"),
        ({"interval": [None, 0.2]}, "no interval"),
        ({"interval": [0.1, 0.1]}, "no interval"),
    ],
)
def test_a_value_that_is_not_bounded_on_both_sides_is_named_and_not_compared(fields, status):
    table = compare_findings(
        {"june": found(cause(DRY, 0.1, 0.02)), "july": found(cause(DRY, 0.1, 0.02) | fields)}
    )
    row = only(table)
    assert (row["status in july"], row["agreement"], row["n_compared"]) == (status, "not compared", 1)
    assert np.isnan([row["chi_square"], row["p_value"], row["p_corrected"]]).all()
    assert agreement_sentences(table) == [f"{DRY}: named in june and july, not compared; {status} in july"]


def test_logs_that_name_nothing_give_an_empty_table_of_the_same_columns():
    table = compare_findings([found(), found()])
    assert len(table) == 0
    assert list(table) == list(compare_findings([found(cause(DRY, 0.1, 0.02)), found()]))
    assert agreement_sentences(table) == []


def test_models_with_different_paths_are_compared_with_a_warning():
    logs = [found(cause(DRY, 0.1, 0.02), model=path) for path in ("arm.xml", "then.xml")]
    with pytest.warns(UserWarning, match=r"log 1 of arm\.xml, log 2 of then\.xml"):
        assert only(compare_findings(logs))["agreement"] == "agree"


def test_another_model_at_the_same_path_is_warned_of_and_a_copy_is_not():
    logs = [found(cause(DRY, 0.1, 0.02), model="arm.xml", model_digest=digest) for digest in ("1a", "2b")]
    with pytest.warns(UserWarning, match="These findings are of different models"):
        compare_findings(logs)
    copied = [found(cause(DRY, 0.1, 0.02), model=path, model_digest="1a") for path in ("arm.xml", "copy.xml")]
    compare_findings(copied)


def test_an_effect_that_a_log_was_not_asked_about_is_told_from_one_that_it_does_not_name():
    table = compare_findings(
        {
            "june": found(cause(DRY, 0.1, 0.02), effects=[DRY]),
            "july": found(effects=["mass[lower]"]),
            "may": found(effects=[DRY]),
        }
    )
    row = only(table)
    assert (row["status in july"], row["status in may"]) == ("not asked", "-")
    assert agreement_sentences(table) == [f"{DRY}: named in june alone; not asked in july"]


GOOD = found(cause(DRY, 0.1, 0.02))
BAD = [
    ({"june": GOOD}, "two logs or more", "got 1"),
    (GOOD, "schema: expected findings", "got int"),
    ([GOOD, [1]], "log 2: expected findings", "got list"),
    ([GOOD, {"schema": 2}], "log 2: expected findings", "verdict, causes, also_seen is not there"),
    ([GOOD, GOOD | {"schema": 1}], "log 2 is of schema 1", "diagnose the log again"),
    ([GOOD, GOOD | {"schema": 99}], "log 2 is of schema 99", "update skat"),
    ([GOOD, found({"name": DRY})], "log 2: expected findings", "unit, value, interval, aliases of a cause"),
    ([GOOD, found(cause(DRY, 0.1, 0.02) | {"interval": [1]})], DRY, "interval [1]"),
    ([GOOD, found(cause(DRY, 0.1, 0.02) | {"value": "much"})], DRY, "value 'much'"),
    *(
        ([GOOD, GOOD | {field: 5}], f"{field} is 5", f"expected {word}")
        for field, word in (
            ("log", "an object"),
            ("gain", "an object"),
            ("causes", "a list"),
            ("effects", "a list"),
        )
    ),
    ([GOOD, found(cause(DRY, 0.1, 0.02) | {"aliases": ["mass"]})], "aliases ['mass']", "a list of objects"),
    ([GOOD, found(cause(5, 0.1, 0.02))], "5 in 'N m' is no cause", "expected two texts"),
    ([GOOD, found(cause(DRY, 0.1, 0.02, "N"))], "in N m in log 1 and in N in log 2", "Compare those of one"),
]


@pytest.mark.parametrize(("findings", "what", "detail"), BAD, ids=[what for _, what, _ in BAD])
def test_what_cannot_be_compared_is_an_error_that_says_where_and_why(findings, what, detail):
    with pytest.raises(ValueError) as error:
        compare_findings(findings)
    assert what in str(error.value)
    assert detail in str(error.value)


def test_names_are_as_many_as_the_findings_distinct_and_those_of_a_mapping_its_own():
    with pytest.raises(ValueError, match="a name for each of 2 findings; got 1"):
        compare_findings([GOOD, GOOD], names=["june"])
    with pytest.raises(ValueError, match="'june' is there 2 times"):
        compare_findings([GOOD, GOOD], names=["june", "june"])
    with pytest.raises(TypeError, match="those of the mapping"):
        compare_findings({"june": GOOD, "july": GOOD}, names=["june", "july"])
