"""The paper's hockey puck: eleven simulations against two pucks that stand for real ones.

The recordings of the paper's authors are not public. What stands in for them is simulated, in worlds of their
own, by `make_real_puck`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import check_random_state

from skat.datasets import make_real_puck
from skat.experiments.methods import METHODS, chosen_methods, fitted_transport, of_repeat
from skat.experiments.scores import covariance_errors, pointwise_errors
from skat.metrics import affinity_score
from skat.simulators import make_simulator

PUCKS = ("blue", "red")
SIMULATIONS = (
    "isotr_low",
    "isotr_lowmed",
    "isotr_med",
    "isotr_medhi",
    "isotr_high",
    "isotr_low_offc",
    "isotr_high_offc",
    "heavy_anisotr_lowx",
    "heavy_anisotr_lowy",
    "low_anisotr_lowx",
    "low_anisotr_lowy",
)
CONTEXT = 2
CURVE_METHODS = (
    "affine",
    "affine_shrunk",
    "procrustes_whitened",
    "conditional",
    "least_squares",
    "target_only",
)
# Those that need no pairs.
UNPAIRED_CURVE_METHODS = ("affine", "affine_scaled", "affine_shrunk", "conditional", "coral")
SIZES = (8, 12, 20, 35, 60, 100, 200)


@dataclass(frozen=True, eq=False)
class Strikes:
    """The same strikes of a real puck and of simulated ones.

    Attributes
    ----------
    z : ndarray of shape (n_strikes, 2)
        Strikes, standard normal.
    measured : ndarray of shape (n_strikes, 2)
        Where the puck came to rest, m.
    simulated : dict of str to ndarray of shape (n_strikes, 2)
        The same by simulation.
    """

    z: np.ndarray
    measured: np.ndarray
    simulated: dict[str, np.ndarray]

    def source_rows(self, simulation: str) -> Any:
        """Return rows (z0, z1, x, y) of a simulation."""
        return np.hstack([self.z, self.simulated[simulation]])

    @property
    def target_rows(self) -> Any:
        """Rows (z0, z1, x, y) as measured."""
        return np.hstack([self.z, self.measured])


def strike_pucks(
    puck: str, *, n_strikes: int, simulations: Any = SIMULATIONS, random_state: Any = 0
) -> Strikes:
    """Strike a real puck, and every simulated one in the same way.

    Parameters
    ----------
    puck : {"blue", "red"}
    n_strikes : int
    simulations : sequence of str
        Conditions of ``make_simulator("puck")``.
    random_state : int, RandomState instance or None, default=0

    Returns
    -------
    Strikes
    """
    rng = check_random_state(random_state)
    z = rng.standard_normal((n_strikes, 2))
    measured = make_real_puck(puck, z, random_state=rng)
    return Strikes(
        z, measured, {name: make_simulator("puck", condition=name).predict(z) for name in simulations}
    )


def repeated_strikes_error(
    puck: str, *, n_strikes: int = 10, n_repeats: int = 20, random_state: Any = 0
) -> pd.Series:
    """Return how far a puck comes to rest from where the same strike sends it on average.

    No prediction from the strike does better.

    Parameters
    ----------
    puck : {"blue", "red"}
    n_strikes : int, default=10
        Different strikes.
    n_repeats : int, default=20
        Times that each is repeated.
    random_state : int, RandomState instance or None, default=0

    Returns
    -------
    float
        Mean distance, m.
    """
    rng = check_random_state(random_state)
    z = np.repeat(rng.standard_normal((n_strikes, 2)), n_repeats, axis=0)
    places = make_real_puck(puck, z, random_state=rng).reshape(n_strikes, n_repeats, 2)
    distances = np.linalg.norm(places - places.mean(axis=1, keepdims=True), axis=2)
    # The mean of the repeats leans towards each of them.
    return float(distances.mean() * np.sqrt(n_repeats / (n_repeats - 1)))


def puck_table(
    *,
    pucks: Sequence[str] = PUCKS,
    simulations: Any = SIMULATIONS,
    methods: Any = None,
    n_strikes: int = 100,
    random_state: Any = 0,
    n_repeats: int = 5,
    n_test: int = 300,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Carry eleven simulations of a struck puck onto two real ones, by every method.

    Rows are (z0, z1, x, y): the strike, standard normal, and the resting place in m. Maps act on whole rows.
    The recordings of the paper's authors are not public: the "real" pucks are simulated, in worlds of their
    own; see `skat.datasets.make_real_puck`.

    Parameters
    ----------
    pucks : sequence of {"blue", "red"}
    simulations : sequence of str
        Conditions of ``make_simulator("puck")``.
    methods : list of str, or dict of str to transport, default=None
        Names of methods, or transports of your own. None: all but "diagnosis", which takes minutes for each
        puck and simulation. It and the exact transport run in the first repeat only.
    n_strikes : int, default=100
        Strikes to fit on. Methods whose name has "disjoint" see one half simulated, the other half measured.
    random_state : int, RandomState instance or None, default=0
    n_repeats : int, default=5
        Times that each method is fitted to new strikes; the table has means.
    n_test : int, default=300
        Other strikes, which all errors are measured on.
    progress : callable, default=None
        Called with (stage, done, total).

    Returns
    -------
    DataFrame
        A row for each puck, simulation and method:

        - error_before, error_after: mean distance, m, of the simulated and of the carried resting place from
          the measured one (the paper's "Sim Error" and "Sim2Real Error");
        - error_before_spread, error_after_spread: standard deviation of that distance over strikes (the
          paper's figure after the sign ±);
        - rho: affinity score of carried and measured resting places, of all the strikes tested;
        - rho_rows: the same of whole rows. The strike has no unit and is the same on both sides, so that this
          score is the higher, the wider strikes are scattered;
        - covariance_error: Frobenius distance between the covariances of carried and measured resting places,
          x and y in standard deviations of the latter, over the norm of the latter's covariance;
        - noise: mean distance of repeated strikes from their mean, m; no prediction does better;
        - error_after_std, rho_std: standard deviation over repeats (NaN for one).

    Raises
    ------
    ValueError
        If there is no such puck, simulation or method.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Table II.
    """
    chosen = chosen_methods(methods, METHODS)
    rng = check_random_state(random_state)
    report = progress or _silent
    records = []
    n_steps = len(pucks) * len(simulations) * n_repeats
    n_all = n_strikes * n_repeats + n_test
    for number, (puck, seed) in enumerate(zip(pucks, rng.randint(2**31, size=len(pucks)))):
        report("striking", number, len(pucks))
        noise = repeated_strikes_error(puck, random_state=seed)
        strikes = strike_pucks(puck, n_strikes=n_all, simulations=simulations, random_state=seed)
        report("striking", number + 1, len(pucks))
        tested = np.arange(n_strikes * n_repeats, n_all)
        expected = strikes.target_rows[tested]
        for place, simulation in enumerate(simulations):
            before = pointwise_errors(strikes.source_rows(simulation)[tested], expected, CONTEXT)
            for repeat in range(n_repeats):
                report("carrying", (number * len(simulations) + place) * n_repeats + repeat, n_steps)
                fitted = (np.arange(repeat * n_strikes, (repeat + 1) * n_strikes),) * 2
                now, case = of_repeat(chosen, repeat), {"puck": puck, "simulation": simulation}
                records += [
                    {**case, "method": name, **_measures(rows, before, expected), "noise": noise}
                    for name, rows in _carried(strikes, simulation, now, fitted, tested, seed)
                ]
    report("carrying", n_steps, n_steps)
    groups = pd.DataFrame(records).groupby(["puck", "simulation", "method"], sort=False)
    deviations = groups[["error_after", "rho"]].std().add_suffix("_std")
    return groups.mean().join(deviations).reset_index()


def in_columns_of_paper(table: pd.DataFrame, method: Any = "affine") -> pd.DataFrame:
    """Return a puck table as the paper prints it.

    Parameters
    ----------
    table : DataFrame
        As `puck_table` returns it.
    method : str, default="affine"

    Returns
    -------
    DataFrame
        Columns Puck, Simulation, Sim2Real Error, Sim Error and rho; errors are mean ± standard deviation over
        strikes, m.

    Raises
    ------
    ValueError
        If the table does not have this method.
    """
    rows = table[table["method"] == method]
    if rows.empty:
        raise ValueError(
            f"the table has no method {method!r}. It has: {', '.join(dict.fromkeys(table['method']))}"
        )
    errors = {
        name: [
            f"{mean:.2f} ± {spread:.2f}"
            for mean, spread in zip(rows[f"error_{when}"], rows[f"error_{when}_spread"])
        ]
        for name, when in (("Sim2Real Error", "after"), ("Sim Error", "before"))
    }
    return pd.DataFrame(
        {
            "Puck": rows["puck"].to_numpy(),
            "Simulation": rows["simulation"].to_numpy(),
            **errors,
            "rho": [f"{rho:.2f}" for rho in rows["rho"]],
        }
    )


def puck_learning_curve(
    *,
    puck: str = "blue",
    simulations: Any = SIMULATIONS,
    methods: Any = CURVE_METHODS,
    sizes: Any = SIZES,
    n_measured: Any = None,
    random_state: Any = 0,
    n_repeats: int = 20,
    n_test: int = 300,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Carry simulations of a struck puck onto a real one, with more and more strikes to fit on.

    Rows are as for `puck_table`, and so is what stands in for the real puck.

    Parameters
    ----------
    puck : {"blue", "red"}
    simulations : sequence of str
        Conditions of ``make_simulator("puck")``.
    methods : list of str, or dict of str to transport
        Names of methods, or transports of your own.
    sizes : sequence of int
        Numbers of strikes to fit on.
    n_measured : int, default=None
        None: every strike is measured and simulated. Else so many are measured, and `sizes` are the numbers of
        simulated ones, the measured among them as far as they go: for methods that need no pairs.
    random_state : int, RandomState instance or None, default=0
    n_repeats : int, default=20
        Times that each method is fitted to other strikes of that number, drawn from twice the largest number.
    n_test : int, default=300
        Other strikes, which all errors are measured on.
    progress : callable, default=None
        Called with (stage, done, total).

    Returns
    -------
    DataFrame
        A row for each puck, simulation, method and n_strikes: error_before, error_after (mean distance, m)
        and error_after_std (standard deviation over repeats; the paper's figure shades twice that).

    Raises
    ------
    ValueError
        If there is no such puck, simulation or method.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. The learning curve.
    """
    chosen = chosen_methods(methods, CURVE_METHODS)
    rng = check_random_state(random_state)
    report = progress or _silent
    report("striking", 0, 1)
    pool = 2 * max(sizes)
    strikes = strike_pucks(puck, n_strikes=pool + n_test, simulations=simulations, random_state=rng)
    report("striking", 1, 1)
    tested = np.arange(pool, pool + n_test)
    expected = strikes.target_rows[tested]
    records = []
    n_steps = len(sizes) * n_repeats
    for place, size in enumerate(sizes):
        for repeat in range(n_repeats):
            report("carrying", place * n_repeats + repeat, n_steps)
            order, seed = rng.permutation(pool), rng.randint(2**31)
            fitted = order[:size], order[: size if n_measured is None else n_measured]
            for simulation in simulations:
                case = {"puck": puck, "simulation": simulation, "n_strikes": size}
                before = pointwise_errors(strikes.source_rows(simulation)[tested], expected, CONTEXT).mean()
                for name, rows in _carried(strikes, simulation, chosen, fitted, tested, seed):
                    after = pointwise_errors(rows, expected, CONTEXT).mean()
                    records.append({**case, "method": name, "error_before": before, "error_after": after})
    report("carrying", n_steps, n_steps)
    groups = pd.DataFrame(records).groupby(["puck", "simulation", "method", "n_strikes"], sort=False)
    means = groups[["error_before", "error_after"]].mean()
    return means.join(groups[["error_after"]].std().add_suffix("_std")).reset_index()


def _carried(
    strikes: Strikes, simulation: str, chosen: Mapping[str, Any], fitted: Any, tested: Any, seed: int
) -> Any:
    """Yield the name of each method, and the tested rows as it carries them.

    Strikes to fit on are given as those that were simulated, and those that were measured.
    """
    source_rows, target_rows = strikes.source_rows(simulation), strikes.target_rows
    simulated, measured = fitted
    for name, method in chosen.items():
        if method is None:
            yield name, _diagnosed(strikes, simulation, measured, tested, seed)
        else:
            transport = fitted_transport(method, source_rows[simulated], target_rows[measured], CONTEXT)
            yield name, transport.transform(source_rows[tested])


def _measures(rows: Any, before: Any, expected: Any) -> Any:
    """Return what the puck table has of carried rows."""
    after = pointwise_errors(rows, expected, CONTEXT)
    return {
        "error_before": before.mean(),
        "error_before_spread": before.std(),
        "rho": affinity_score(rows[:, CONTEXT:], expected[:, CONTEXT:]),
        "rho_rows": affinity_score(rows, expected),
        "error_after": after.mean(),
        "error_after_spread": after.std(),
        "covariance_error": covariance_errors(rows, expected, CONTEXT)["covariance_error"],
    }


def _diagnosed(strikes: Strikes, simulation: str, fitted: Any, tested: Any, seed: int) -> Any:
    """Return the tested rows as the simulation predicts them once the measured strikes extended it."""
    from skat.diagnosis import SimulationDiagnosis

    diagnosis = SimulationDiagnosis(
        make_simulator("puck", condition=simulation), test_size=0, random_state=seed
    )
    diagnosis.fit(strikes.z[fitted], strikes.measured[fitted])
    return np.hstack([strikes.z[tested], diagnosis.extended_simulator_.predict(strikes.z[tested])])


def _silent(stage: str, done: int, total: int) -> None:
    """Report to nobody."""
