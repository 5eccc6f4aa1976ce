"""Repairs of a log that are tried: all of them, the error that each leaves by hand, and the options that make it.

The simulation is of two carts, whose velocity changes by what they are told and whose position by their velocity.
"""

import numpy as np
import pytest

from skat.logs import load_log, suspects
from skat.logs.log import Log
from skat.logs.suspects import in_degrees
from skat.simulators import FunctionSimulator, MujocoSimulator

NAMES = ("qpos.a", "qpos.b", "qvel.a", "qvel.b", "ctrl.a", "ctrl.b")
DT = 0.01
PUSH = np.array([10.0, 20.0])
ANGLES = dict(zip(NAMES, ("rad", "rad", "rad/s", "rad/s")))


def step(X, sign=1.0):
    return np.hstack([X[:, :2] + DT * X[:, 2:4], X[:, 2:4] + sign * DT * X[:, 4:]])


def carts(sign=1.0, units=None):
    return FunctionSimulator(
        lambda X: step(X, sign), input_names=NAMES, output_names=NAMES[:4], state_names=NAMES[:4], dt=DT, units=units
    )  # fmt: skip


def motion(n_rows=40, **changed):
    """Return a log that the simulation meets exactly, in which each cart is pushed to and fro as it happens."""
    commands = PUSH * np.random.default_rng(0).choice([-1.0, 1.0], size=(n_rows, 2))
    rows = np.hstack([np.zeros((n_rows, 4)), commands])
    for row in range(1, n_rows):
        rows[row, :4] = step(rows[row - 1 : row])[0]
    return {"time": DT * np.arange(n_rows)} | dict(zip(NAMES, rows.T)) | changed


def turned(source, *names):
    return source | {name: -source[name] for name in names}


def tried(source, simulator=None, told=None, **options):
    log = load_log(source, simulator or carts(), **(told or {}))
    return suspects(log.simulator, log, **options)


def share(missed, changed):
    """Return the root mean square over channels of what 7 of 10 rows miss at most, as a share of what changes."""
    missed, changed = np.abs(missed), np.abs(changed)
    ratios = np.quantile(missed, 0.7, axis=0, method="lower") / np.quantile(changed, 0.7, axis=0)
    return np.sqrt(np.mean(ratios**2))


def test_every_repair_is_told_with_the_error_that_it_leaves_and_its_options():
    source = turned(motion(), "ctrl.a")
    found = {suspect.sentence: suspect for suspect in tried(source)}
    one, both, odd = np.sqrt(2), 2.0, np.sqrt((3**2 + 1.5**2) / 2)
    expected = {}
    for cart, left in (("a", 0.0), ("b", both)):
        state = [f"qpos.{cart}", f"qvel.{cart}"]
        for names in (state, state[1:], [f"ctrl.{cart}"]):
            has = "have" if len(names) > 1 else "has"
            options = {"columns": {name: f"{name}:-x:1" for name in names}}
            expected[f"{' and '.join(names)} {has} the opposite sign"] = ("sign", one, left, options)
    for kinds in (["ctrl"], ["qpos", "qvel"]):
        pairs = [(f"{kind}.a", f"{kind}.b") for kind in kinds]
        options = {"columns": dict([*pairs, *(pair[::-1] for pair in pairs)])}
        expected[f"{' and '.join(pairs[0])} are swapped"] = ("swap", one, odd, options)
    velocities = np.column_stack([source["qvel.a"], source["qvel.b"]])
    pushes = PUSH * np.sign(np.column_stack([-source["ctrl.a"], source["ctrl.b"]]))[:-1]
    for lag, rows in ((-2, "2 rows earlier"), (-1, "1 row earlier"), (1, "1 row later"), (2, "2 rows later")):
        moved = np.clip(np.arange(39) + lag, 0, 38)
        told = pushes * [-1, 1]
        expected[
            f"the commands fit those of {rows}: the clocks of commands and state are apart, or there is a delay"
        ] = ("shift", one, share(DT * (pushes - told[moved]), DT * pushes), {})
        expected[
            f"the velocities fit those of {rows}: the clocks of velocities and positions are apart, or a filter delays "
            "one of them"
        ] = ("shift", 0.0, share(DT * (velocities[moved] - velocities[:-1]), DT * velocities[:-1]), {})
    assert found.keys() == expected.keys()
    for sentence, (kind, error, repaired, options) in expected.items():
        suspect = found[sentence]
        assert (suspect.kind, suspect.options) == (kind, options), sentence
        np.testing.assert_allclose(
            [suspect.error, suspect.repaired], [error, repaired], atol=1e-9, err_msg=sentence
        )
    shares = [suspect.repaired / max(suspect.error, 1e-300) for suspect in found.values()]
    assert shares == sorted(shares)


@pytest.mark.parametrize(
    ("unit", "mended"),
    [
        ("", "u:-x:1"),
        ("A:0.5", "u:-A:0.5"),
        ("-A:0.5", None),
        ("A:0.5+3", None),
        ("mNm-3", None),
    ],
)
def test_a_sign_is_mended_in_the_unit_of_the_column_where_that_can_be_written(unit, mended):
    source = motion()
    source["u"] = source.pop("ctrl.a")
    found = tried(source, told={"columns": {"ctrl.a": f"u:{unit}" if unit else "u"}})
    options = {suspect.sentence: suspect.options for suspect in found}
    expected = {"columns": {"ctrl.a": mended}} if mended else {}
    assert options["ctrl.a has the opposite sign"] == expected
    theirs = f"u:{unit}" if unit else "u"
    assert options["ctrl.a and ctrl.b are swapped"] == {"columns": {"ctrl.a": "ctrl.b", "ctrl.b": theirs}}


def test_a_sign_is_mended_in_the_unit_of_the_simulation_where_the_column_has_none():
    options = {suspect.sentence: suspect.options for suspect in tried(motion(), carts(units=ANGLES))}
    assert options["qvel.b has the opposite sign"] == {"columns": {"qvel.b": "qvel.b:-rad/s"}}
    assert options["ctrl.b has the opposite sign"] == {"columns": {"ctrl.b": "ctrl.b:-x:1"}}


def test_velocities_are_differences_of_positions_where_none_were_measured():
    time = DT * np.arange(50)
    positions = np.cumsum(np.r_[0.0, np.cumsum(np.full(49, DT * DT))])
    source = {"time": time} | {f"ctrl.{cart}": np.full(50, push) for cart, push in zip("ab", PUSH)}
    source |= {f"qpos.{cart}": push * positions for cart, push in zip("ab", PUSH)}
    found = {suspect.sentence: suspect for suspect in tried(source)}
    assert "qvel.a has the opposite sign" not in found
    assert not any(sentence.startswith("the velocities fit") for sentence in found)
    for sentence in ("qpos.a has the opposite sign", "ctrl.a has the opposite sign"):
        np.testing.assert_allclose(
            [found[sentence].error, found[sentence].repaired], [0, np.sqrt(2)], atol=1e-6
        )
    assert found["qpos.a and qpos.b are swapped"].options == {
        "columns": {"qpos.a": "qpos.b", "qpos.b": "qpos.a"}
    }


@pytest.mark.parametrize(("n_rows", "is_enough"), [(9, False), (10, True)])
def test_ten_rows_are_needed(n_rows, is_enough):
    log = load_log(motion(), carts()).rows(slice(0, n_rows))
    assert bool(suspects(log.simulator, log)) == is_enough


def test_kinds_are_those_that_are_asked_for():
    assert {suspect.kind for suspect in tried(motion())} == {"sign", "swap", "shift"}
    assert {suspect.kind for suspect in tried(motion(), kinds=("sign", "swap"))} == {"sign", "swap"}
    assert tried(motion(), kinds=("degrees",)) == []


def test_of_several_simulations_that_counts_which_leaves_least():
    log = load_log(turned(motion(), "ctrl.a", "ctrl.b"), carts())
    for simulators in ([carts(), carts(-1.0)], [carts(-1.0), carts()]):
        found = {suspect.sentence: suspect for suspect in suspects(simulators, log)}
        assert found["ctrl.a has the opposite sign"].error == pytest.approx(0, abs=1e-9)
        assert found["ctrl.a has the opposite sign"].repaired == pytest.approx(np.sqrt(2))


def test_channels_that_stand_still_do_not_count():
    still = np.zeros(40)
    source = turned(motion(), "ctrl.a") | dict.fromkeys(("qpos.b", "qvel.b", "ctrl.b"), still)
    found = {suspect.sentence: suspect for suspect in tried(source)}
    assert found["ctrl.a has the opposite sign"].error == pytest.approx(2.0)
    assert tried(source | dict.fromkeys(NAMES, still)) == []


@pytest.mark.parametrize(("n_rows", "error"), [(50, 0.0), (100, 0.0), (150, np.sqrt(2))])
def test_rows_that_stand_for_a_log_are_runs_of_fifty_from_beginning_to_end(n_rows, error):
    """A mistake of half of the log is seen where a run falls into it: of three runs the middle one, of two none."""
    source = motion(401)
    commands = source["ctrl.a"].copy()
    commands[60:340] *= -1
    found = {suspect.sentence: suspect for suspect in tried(source | {"ctrl.a": commands}, n_rows=n_rows)}
    assert found["ctrl.a has the opposite sign"].error == pytest.approx(error, abs=1e-9)


# -- degrees -----------------------------------------------------------------------------------------------------------


def pendulums(n_rows=60):
    """Return a simulation whose angles matter, and a log of it."""

    def swing(X):
        speeds = X[:, 2:4] + DT * (X[:, 4:] - 50 * X[:, :2])
        return np.hstack([X[:, :2] + DT * speeds, speeds])

    simulator = FunctionSimulator(
        swing, input_names=NAMES, output_names=NAMES[:4], state_names=NAMES[:4], dt=DT, units=ANGLES
    )
    rows = np.tile([0.3, -0.4, 0.0, 0.0, 1.0, -2.0], (n_rows, 1))
    for row in range(1, n_rows):
        rows[row, :4] = swing(rows[row - 1 : row])[0]
    return simulator, {"time": DT * np.arange(n_rows)} | dict(zip(NAMES, rows.T))


def in_deg(source, names):
    return source | {name: np.rad2deg(source[name]) for name in names}


@pytest.mark.parametrize(
    ("scaled", "sentence", "units"),
    [
        (NAMES[:4], "the angles, their rates and the commands of servos look like degrees", "deg"),
        (NAMES[:2], "the angles look like degrees, their rates like rad/s", {"qpos.*": "deg"}),
    ],
)
def test_degrees_are_told_apart_by_how_far_positions_move(scaled, sentence, units):
    simulator, source = pendulums()
    log = load_log(in_deg(source, scaled), simulator, units={"q*": "rad"})
    suspect = in_degrees(simulator, log)
    assert suspect.sentence.startswith(
        f"{sentence}: read so, one step of the simulation misses the velocities by "
    )
    assert suspect.options == {"units": units}
    assert suspect.repaired < 1e-9 < suspect.error
    told = {found.sentence for found in suspects(simulator, log, kinds=("degrees",))}
    assert told == {sentence}
    mended = load_log(in_deg(source, scaled), simulator, **suspect.options)
    np.testing.assert_allclose(mended.X, load_log(source, simulator).X, rtol=1e-12)
    assert in_degrees(simulator, log, told=frozenset(NAMES[:2])) is None
    assert in_degrees(simulator, load_log(source, simulator)) is None


@pytest.mark.parametrize(("largest", "is_told"), [(2.99, False), (3.01, True)])
def test_angles_of_less_than_three_are_no_degrees(largest, is_told):
    simulator, source = pendulums()
    factor = largest / np.rad2deg(np.abs(source["qpos.b"][:-1]).max())
    small = source | {name: factor * source[name] for name in NAMES}
    log = load_log(in_deg(small, NAMES[:4]), simulator, units={"q*": "rad"})
    assert (in_degrees(simulator, log) is not None) == is_told


HINGE = """
<mujoco><compiler angle="radian"/><worldbody><body><joint name="hip" axis="0 1 0" range="{}" limited="true"/>
<inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>
"""


@pytest.mark.parametrize(
    ("ends", "angle", "said"),
    [
        ((-1.5, 1.5), 4.49, None),
        ((-1.5, 1.5), 4.51, "4.51 where the joint allows -1.5 to 1.5"),
        ((-1.5, 1.5), -4.51, "-4.51 where the joint allows -1.5 to 1.5"),
        # In degrees it is 1.8 rad, a fifth beyond the range, at most.
        ((-1.5, 1.5), np.rad2deg(1.79), "103 where the joint allows -1.5 to 1.5"),
        ((-1.5, 1.5), np.rad2deg(1.81), None),
        ((0.5, 2.5), np.rad2deg(0.31), "17.8 where the joint allows 0.5 to 2.5"),
        ((0.5, 2.5), np.rad2deg(0.29), None),
        ((0.5, 2.5), -np.rad2deg(1.0), None),
    ],
)  # fmt: skip
def test_what_exceeds_a_joints_range_by_its_width_and_keeps_to_it_in_degrees_looks_like_them(
    ends, angle, said
):
    simulator = MujocoSimulator(HINGE.format("{} {}".format(*ends)))
    X = np.column_stack([np.full(8, angle), np.zeros(8)])
    log = Log(X, X, np.zeros(8, int), ("0",), 0.01 * np.arange(8), simulator)
    suspect = in_degrees(simulator, log)
    assert (suspect and suspect.sentence) == (
        said and f"qpos.hip reaches {said} rad: these look like degrees."
    )
    assert in_degrees(simulator, log, told=frozenset(["qpos.hip"])) is None
    if said:
        assert (suspect.kind, suspect.options) == ("degrees", {"units": "deg"})
