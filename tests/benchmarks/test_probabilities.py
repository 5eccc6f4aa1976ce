"""Probabilities of causes that a log hardly parts, of two logs that are drawn from the prior."""

import pytest


def answer_of(seed):
    import probabilities

    (case,) = (one for one in probabilities.cases(cut=False) if one.seed == seed)
    return probabilities.run(case, {})


@pytest.mark.parametrize(
    ("seed", "name", "between", "alias", "at_least"),
    [
        # Damping of one joint is true and .4 nats behind damping of both, beside which a mass that is off counts.
        (9073, "damping[all]", (0.5, 0.75), "damping[hinge]", 0.25),
        # Beside a dead motor, 4 nats behind, slopes have a sensor's scale tell what no fit does.
        (9070, "dry_friction[slider]", (0.9, 1.0), "", 0.0),
    ],
)
def test_what_may_act_beside_a_cause_counts_beside_its_rivals_alike(seed, name, between, alias, at_least):
    (cause,) = answer_of(seed)["causes"]
    assert cause["name"] == name
    assert between[0] < cause["probability"] < between[1]
    assert dict(cause["aliases"]).get(alias, 0.0) >= at_least
