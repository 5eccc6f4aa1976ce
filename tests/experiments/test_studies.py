"""Diagnoses of measured data, with their gain on data that they did not use."""

import os

import numpy as np
import pytest

from skat.datasets import make_hidden_puck
from skat.experiments.studies import (
    ball_drop_table,
    study_ball_drops,
    study_cube_tosses,
    study_hidden_puck,
    study_pendulum,
)

NO_DATA = pytest.mark.skipif(not os.environ.get("SKAT_DATA_HOME"), reason="SKAT_DATA_HOME is not set")


@NO_DATA
@pytest.mark.parametrize(
    ("ball", "times_smaller"),
    [
        ("Whiffle Ball 1", 10),
        pytest.param(
            "Tennis Ball",
            3,
            marks=[
                pytest.mark.long,
                pytest.mark.xfail(
                    strict=True,
                    reason="Nothing detected: on one drop of 2 s a random force of .65 N, as large as the ball's "
                    "weight, explains what drag does; damping[z] has a probability of .25, air_drag[z] of .005",
                ),
            ],
        ),
    ],
)
def test_drag_of_a_light_ball_is_named_and_makes_the_error_many_times_smaller(ball, times_smaller):
    study = study_ball_drops([ball])[ball]
    named = {name for cause in study.diagnosis.causes_ for name in (cause.name, *map(str, cause.aliases))}
    assert named & {"air_drag[z]", "air_drag[all]", "damping[z]", "damping[all]"}
    assert study.gain.ratio > times_smaller


@NO_DATA
def test_nothing_is_named_that_does_not_gain_on_the_other_drop():
    ball = "Bowling Ball"
    study = study_ball_drops([ball])[ball]
    assert not study.diagnosis.causes_ or study.gain.ratio > 1
    table = ball_drop_table({ball: study})
    assert list(table["ball"]) == [ball]
    assert table["nominal"].item() == study.gain.nominal


@NO_DATA
@pytest.mark.parametrize(
    "options",
    [
        pytest.param(
            {"n_test": 6, "effects": ["contact_friction[all]", "tilt[x]"]},
            marks=[
                pytest.mark.long,
                pytest.mark.xfail(
                    strict=True, reason="The factor on the friction is .70, with the evidence of 52 nats"
                ),
            ],
        ),
        pytest.param({"n_test": 12}, marks=pytest.mark.long, id="all"),
    ],
)
def test_friction_of_the_cube_is_named_and_tilt_is_not(options):
    study = study_cube_tosses(n_fit=5, **options)
    causes = {cause.family: cause for cause in study.diagnosis.causes_}
    # Much is left, but nothing that explains a tenth of it.
    assert set(causes) <= {"contact_friction", "restitution"}
    assert 0.15 < causes["contact_friction"].value < 0.25  # a factor on the default coefficient, which is 1
    assert study.gain.ratio > 3.5


@NO_DATA
@pytest.mark.long
@pytest.mark.xfail(
    strict=True,
    reason="Nothing detected: a random force of 1.4 N m on the motor explains what friction does; dry_friction[hinge] "
    "has a probability of .48, damping[hinge] of .22",
)
@pytest.mark.parametrize(
    "others",
    [[], ["gain[motor]", "mass[weight]", "delay[action]", "bias[qpos.hinge]"]],
)
def test_dry_friction_of_the_pendulums_motor_is_named_and_gains_on_other_pieces(others):
    study = study_pendulum(effects=["dry_friction[hinge]", "damping[hinge]", *others])
    causes = {cause.name: cause for cause in study.diagnosis.causes_}
    assert 0.15 < causes["dry_friction[hinge]"].value < 0.3
    assert not {"delay[action]", "bias[qpos.hinge]"} & set(causes)
    assert study.gain.ratio > 3


@pytest.mark.parametrize(
    ("n_shots", "effects"),
    [
        (40, ["tilt[y]", "contact_friction[slide]"]),
        # Of the simulator's effects those that push sideways or shorten the way.
        pytest.param(
            60,
            ["tilt[x]", "tilt[y]", "wind[x]", "wind[y]", "contact_friction[slide]", "mass[puck]"],
            marks=pytest.mark.long,
        ),
    ],
)
def test_demo_finds_what_the_world_hides_or_an_alias_of_it_and_compares_every_method(n_shots, effects):
    study = study_hidden_puck(n_shots=n_shots, random_state=0, effects=effects)
    truth = make_hidden_puck(random_state=0)
    ((name, size),) = truth.truth.items()
    assert study.truth == f"{name} = {size:.3g}. {truth.truth_sentence}"
    assert name in effects
    assert any(name in (cause.name, *map(str, cause.aliases)) for cause in study.diagnosis.causes_)
    assert study.gain.extended < 0.5 * study.gain.nominal
    errors = study.errors.set_index("method")["error"]
    assert {"AffineTransport", "ProcrustesAffineTransport", "CORAL", "ExactTransport"} < set(errors.index)
    assert np.isfinite(errors).all()
