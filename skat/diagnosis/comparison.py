"""How far maps learned from data alone come beside the named causes: a ceiling of what could be explained."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.base import clone
from sklearn.utils import check_random_state
from sklearn.utils.validation import check_is_fitted

from skat.diagnosis.chains import Array, Mask, Places
from skat.diagnosis.log import Log, without_channels
from skat.diagnosis.prediction import FEWEST_PIECES, N_BOOTSTRAP, ends, in_open_loop, pieces_of
from skat.diagnosis.statespace import tangent_mask, tangents
from skat.simulators import Simulator
from skat.transport import (
    CORAL,
    AffineTransport,
    ConditionalAffineTransport,
    ExactTransport,
    ProcrustesAffineTransport,
)

NOMINAL, EXTENDED = "nominal simulation", "extended simulation"
# Made for so many columns of inputs, which come first.
TRANSPORTS: Mapping[str, Callable[[int], Any]] = {
    "AffineTransport": lambda _: AffineTransport(),
    "ProcrustesAffineTransport": lambda _: ProcrustesAffineTransport(),
    "ConditionalAffineTransport": lambda n: ConditionalAffineTransport(context=n),
    "CORAL": lambda _: CORAL(),
    "ExactTransport": lambda _: ExactTransport(),
}
# Exact transport takes time and memory with the square of the number of rows.
MOST_EXACT_ROWS = 2_000
# A map learned from noisy states averages some of their noise out, which the true simulation cannot: a
# smaller advantage than this is no sign of a cause.
TELLING_RATIO = 0.95
# Relative to the largest singular value of standardised columns.
RANK_TOLERANCE = 1e-8


def compare_transports(
    diagnosis: Any,
    X_fit: ArrayLike,
    y_fit: ArrayLike,
    X_test: ArrayLike,
    y_test: ArrayLike,
    *,
    groups_fit: ArrayLike | None = None,
    groups_test: ArrayLike | None = None,
    methods: Sequence[str] | Mapping[str, Any] | None = None,
    random_state: int | np.random.RandomState | None = None,
) -> pd.DataFrame:
    r"""Return held-out errors of the simulation, of maps from it to the data, and of the extended simulation.

    A map is fitted to source rows (inputs, simulated output) and target rows (inputs, measured output), and
    predicts the last columns of the test rows that it carries. Columns are standardised by the target's means
    and standard deviations beforehand, so that no method depends on units.

    Parameters
    ----------
    diagnosis : SimulationDiagnosis
        Fitted.
    X_fit, X_test : array-like of shape (n_rows, n_inputs)
        Inputs to fit the maps on, and others to test on.
    y_fit, y_test : array-like of shape (n_rows, n_outputs)
        What was measured; what the diagnosis took for computed or hidden is left out here, too.
    groups_fit, groups_test : array-like of shape (n_rows,), optional
        Episode of each row, as in `SimulationDiagnosis.fit`. Needed where some channels were not measured.
    methods : sequence of str or mapping from str to transport, optional
        Names among AffineTransport, ProcrustesAffineTransport, ConditionalAffineTransport, CORAL and
        ExactTransport, or unfitted estimators of your own with ``fit(X, y)`` and ``transform(X)``. None: all
        five. The nominal and the extended simulation are always there.
    random_state : int, RandomState or None, default=None
        Which rows exact transport is fitted to, and the bootstrap.

    Returns
    -------
    DataFrame
        A row for each method: `method`; `error`, NaN where a method has no answer, which `note` then
        explains; `ratio` of the error to the extended simulation's, with its 95 % interval `ratio_low`,
        `ratio_high`, NaN where there is none; `n_rows` it was fitted to, 0 for the simulations; `note`; and for
        each output, under its name, the root mean squared error in the output's unit.

    Raises
    ------
    ValueError
        If rows do not fit the simulator, a method is unknown, or no row can be simulated.

    Notes
    -----
    With outputs :math:`j = 1..m`, rows :math:`t = 1..n`, predictions :math:`\hat y` and the standard
    deviations :math:`s_j` of the measured outputs in the rows fitted (1 for constant outputs),

    .. math:: \mathrm{error} = \Bigl(\frac{1}{n m} \sum_{t, j} (y_{tj} - \hat y_{tj})^2 / s_j^2\Bigr)^{1/2}

    so that 1 is the error of predicting the mean. The interval comes from a bootstrap over the same episodes for both
    methods, or, where they are few, pieces of them. Orientations are compared as rotation vectors. Rows in which
    something was not measured are left out. If channels were never measured, the rows are those of whole episodes
    simulated in open loop from fitted initial states; their inputs are the step and the actions, and the bootstrap is
    over episodes. Fewer than five episodes or groups give no interval.

    If the simulated rows vary in fewer directions than the measured ones (a linear simulation), no linear map
    carries one onto the other; they are then fitted with noise of the size of what the extended simulation
    leaves, which the note says.
    """
    check_is_fitted(diagnosis, "extended_simulator_")
    transports = _chosen(methods)
    draws: np.random.RandomState = check_random_state(random_state)
    logs = [
        _log(diagnosis, X_fit, y_fit, groups_fit, "fit"),
        _log(diagnosis, X_test, y_test, groups_test, "test"),
    ]
    unread = [
        name
        for column, name in enumerate(diagnosis.simulator.output_names)
        if any(np.isnan(log.y[:, column]).all() for log in logs)
    ]
    if unread and diagnosis.simulator.state_names:
        for log, what in zip(logs, ("fit", "test")):
            if not log.consecutive:
                raise ValueError(
                    f"{', '.join(unread)} were not measured, so that whole episodes are compared: pass "
                    f"groups_{what}=, the episode of each row."
                )
    make = _trajectory_rows if unread and diagnosis.simulator.state_names else _one_step_rows
    fitted, test = (
        make(diagnosis, without_channels(diagnosis.simulator, log, unread), what)
        for log, what in zip(logs, ("fit", "test"))
    )
    lost = f"{test.n_lost} rows left out, in which a simulation diverges" if test.n_lost else ""
    rows = [_Row(NOMINAL, test.difference(test.nominal), 0, lost)]
    source, noise_note = _source_outputs(fitted, draws)
    for name, transport in transports.items():
        rows.append(_transported(name, transport, fitted, source, test, noise_note, draws))
    rows.append(_Row(EXTENDED, test.difference(test.extended), 0, lost))
    return _table(rows, fitted.spread, test, draws)


def ceiling_sentence(frame: pd.DataFrame) -> str:
    """Return in a sentence whether a map learned from the data beats the named causes.

    `frame`: from `compare_transports`.

    Examples
    --------
    >>> import pandas as pd
    >>> print(ceiling_sentence(pd.DataFrame({
    ...     "method": ["nominal simulation", "AffineTransport", "extended simulation"],
    ...     "error": [0.4, 0.1, 0.2], "ratio": [2.0, 0.5, 1.0],
    ...     "ratio_low": [1.9, 0.4, 1.0], "ratio_high": [2.1, 0.6, 1.0]})))
    AffineTransport beats the extended simulation on data not used: 0.5 times its error (95 %: 0.4 to 0.6).
    Something is left that the named causes do not explain.
    """
    maps = frame[~frame["method"].isin([NOMINAL, EXTENDED]) & frame["error"].notna()]
    if maps.empty:
        return "No transport could be fitted to these data."
    best = maps.loc[maps["error"].idxmin()]
    size = f"{best['ratio']:.3g} times its error"
    if np.isfinite(best["ratio_low"]):
        size += f" (95 %: {best['ratio_low']:.3g} to {best['ratio_high']:.3g})"
    if is_beaten(frame):
        return (
            f"{best['method']} beats the extended simulation on data not used: {size}. "
            "Something is left that the named causes do not explain."
        )
    return f"No transport beats the extended simulation on data not used: {best['method']} has {size}."


def is_beaten(frame: pd.DataFrame) -> bool:
    """Whether a map learned from the data is clearly better than the extended simulation on data not used."""
    maps = frame[~frame["method"].isin([NOMINAL, EXTENDED])]
    return bool(((maps["ratio"] < TELLING_RATIO) & (maps["ratio_high"] < 1)).any())


@dataclass(frozen=True)
class _Rows:
    """Inputs with outputs three times: measured, and simulated by the nominal and the extended model.

    `inputs` (n_rows, n_context). `measured`, `nominal`, `extended` (n_rows, n_columns). `difference`:
    ``difference(prediction)`` returns measured minus predicted, (n_rows, n_channels). `spread` (n_channels,): standard
    deviations of the measured outputs, 1 for constant ones. `blocks` (n_rows,): pieces of time that count as
    independent. `n_lost`: rows left out because a simulation diverged.
    """

    inputs: Array
    measured: Array
    nominal: Array
    extended: Array
    difference: Callable[[Array], Array]
    spread: Array
    channels: tuple[str, ...]
    blocks: Places
    n_lost: int


@dataclass(frozen=True)
class _Row:
    """A method with its errors (n_test_rows, n_channels), or None."""

    method: str
    errors: Array | None
    n_rows: int
    note: str


def _chosen(methods: Sequence[str] | Mapping[str, Any] | None) -> dict[str, Any]:
    if isinstance(methods, Mapping):
        taken = [name for name in methods if name in (NOMINAL, EXTENDED)]
        if taken:
            raise ValueError(f"methods may not be called {taken[0]!r}: the simulations are always compared.")
        return dict(methods)
    names = [methods] if isinstance(methods, str) else list(TRANSPORTS if methods is None else methods)
    unknown = [name for name in names if name not in TRANSPORTS]
    if unknown:
        raise ValueError(
            f"Unknown method {unknown[0]!r}. Methods: {', '.join(TRANSPORTS)}; or pass a mapping from names "
            "to estimators."
        )
    return dict.fromkeys(names)


def _log(diagnosis: Any, X: ArrayLike, y: ArrayLike, groups: ArrayLike | None, what: str) -> Log:
    if groups is None and diagnosis.extended_simulator_.n_lags():
        raise ValueError(
            f"An action was found to be delayed, so that earlier rows count: pass groups_{what}=, the episode of each "
            "row; its rows are consecutive and in time order."
        )
    log: Log = diagnosis._other_log(X, y, groups, undone=False)
    return log


def _one_step_rows(diagnosis: Any, log: Log, what: str) -> _Rows:
    simulator: Simulator = diagnosis.simulator
    filled = log.filled
    nominal, extended = (
        one.predict_many(filled.X, [{}], groups=log.groups)[0]
        for one in (simulator, diagnosis.extended_simulator_)
    )
    there = _there(nominal, extended, log.complete, what)
    X, y, nominal, extended = log.X[there], log.y[there], nominal[there], extended[there]
    difference: Callable[[Array], Array]
    if tuple(simulator.residual_names) == tuple(simulator.output_names):

        def difference(prediction: Array) -> Array:
            return y - prediction
    else:
        # A state with orientations is described by the rotation (and the change) since the row's own state.
        states, measured = X[:, : len(simulator.state_names)], y
        y, nominal, extended = (simulator.residual(one, states) for one in (y, nominal, extended))

        def difference(prediction: Array) -> Array:
            return simulator.residual(measured, simulator.displace(states, prediction))

    spread = _spread(tangents(simulator, log.y[there]))
    lost = int((log.complete & ~there).sum())
    return _Rows(
        X,
        y,
        nominal,
        extended,
        difference,
        spread,
        tuple(simulator.residual_names),
        (pieces_of(log.episodes) if log.consecutive else log.episodes)[there],
        lost,
    )


def _trajectory_rows(diagnosis: Any, log: Log, what: str) -> _Rows:
    simulator: Simulator = diagnosis.simulator
    n_states = len(simulator.state_names)
    channels = np.flatnonzero(log.measured)
    space = diagnosis._space(log, len(log))
    error = np.nan_to_num(diagnosis.noise_, nan=1.0)[None] ** 2
    nominal, extended = (
        simulator.residual(ends(space)[0], path[:, 1:][space.places])[:, channels]
        for one in (simulator, diagnosis.extended_simulator_)
        for path, _ in [in_open_loop(replace(space, simulator=one), {}, error)]
    )
    measured = tangents(simulator, log.filled.y)[:, channels]
    seen = np.asarray(tangent_mask(simulator, np.isfinite(log.y))[:, channels].all(axis=1))
    there = _there(nominal, extended, seen, what)
    measured = measured[there]
    inputs = np.column_stack([log.steps, log.X[:, n_states:]])[there]
    return _Rows(
        inputs,
        measured,
        measured - nominal[there],
        measured - extended[there],
        lambda prediction: measured - prediction,
        _spread(measured),
        tuple(np.array(simulator.residual_names)[channels].tolist()),
        log.episodes[there],  # In open loop an error lasts through its episode.
        int((seen & ~there).sum()),
    )


def _there(nominal: Array, extended: Array, measured: Mask, what: str) -> Mask:
    """Return the rows that were measured and in which no simulation diverges."""
    if not measured.any():
        raise ValueError(f"No row of y_{what} was measured as a whole: there is nothing to compare.")
    there = measured & np.isfinite(nominal).all(axis=1) & np.isfinite(extended).all(axis=1)
    if not there.any():
        raise ValueError(
            f"The simulation diverges in every row of X_{what}; check that these rows are physical."
        )
    return np.asarray(there)


def _source_outputs(fitted: _Rows, random_state: np.random.RandomState) -> tuple[Array, str]:
    """Return simulated outputs to fit on, with noise where they vary in fewer directions than measured."""
    source = _rank(np.column_stack([fitted.inputs, fitted.nominal]))
    target = _rank(np.column_stack([fitted.inputs, fitted.measured]))
    if source >= target:
        return fitted.nominal, ""
    deviations = (fitted.measured - fitted.extended).std(axis=0)
    noisy = fitted.nominal + random_state.standard_normal(fitted.nominal.shape) * deviations
    return noisy, "fitted with noise added to the simulated rows: their outputs are linear in the inputs"


def _rank(rows: Array) -> int:
    centred = rows - rows.mean(axis=0)
    values = np.linalg.svd(centred / _spread(rows), compute_uv=False)
    return int((values > RANK_TOLERANCE * values.max(initial=0.0)).sum())


def _spread(rows: Array) -> Array:
    """Return standard deviations of columns, 1 where a column is constant up to rounding."""
    return np.where(_varies(rows), rows.std(axis=0), 1.0)


def _without_rounding(rows: Array) -> Array:
    """Return rows with columns that are constant up to rounding made constant."""
    return np.where(_varies(rows), rows, rows[:1])


def _varies(rows: Array) -> Mask:
    return np.asarray(rows.std(axis=0) > 1e-12 * np.abs(rows).max(axis=0, initial=0.0))


def _transported(
    name: str,
    transport: Any,
    fitted: _Rows,
    outputs: Array,
    test: _Rows,
    note: str,
    random_state: np.random.RandomState,
) -> _Row:
    n_context = fitted.inputs.shape[1]
    target = _without_rounding(np.column_stack([fitted.inputs, fitted.measured]))
    mean, spread = target.mean(axis=0), _spread(target)
    source = (_without_rounding(np.column_stack([fitted.inputs, outputs])) - mean) / spread
    target = (target - mean) / spread
    notes = [note] if note else []
    if name == "ExactTransport" and len(source) > MOST_EXACT_ROWS:
        chosen = random_state.permutation(len(source))[:MOST_EXACT_ROWS]
        notes.append(f"fitted to {MOST_EXACT_ROWS} of {len(source)} rows, drawn at random")
        source, target = source[chosen], target[chosen]
    estimator = TRANSPORTS[name](n_context) if transport is None else clone(transport)
    carried = (np.column_stack([test.inputs, test.nominal]) - mean) / spread
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            carried = np.asarray(estimator.fit(source, target).transform(carried))
    except ValueError as error:
        return _Row(name, None, len(source), "; ".join([*notes, f"no answer: {error}"]))
    notes += dict.fromkeys(str(one.message) for one in caught)
    prediction = carried[:, n_context:] * spread[n_context:] + mean[n_context:]
    return _Row(name, test.difference(prediction), len(source), "; ".join(notes))


def _table(
    rows: Sequence[_Row], scale: Array, test: _Rows, random_state: np.random.RandomState
) -> pd.DataFrame:
    labels = np.unique(test.blocks, return_inverse=True)[1]
    draws = random_state.randint(labels.max() + 1, size=(N_BOOTSTRAP, labels.max() + 1))
    sums = {
        row.method: np.bincount(labels, np.sum((row.errors / scale) ** 2, axis=1))
        for row in rows
        if row.errors is not None
    }
    reference = sums[EXTENDED]
    enough = len(draws[0]) >= FEWEST_PIECES
    records = []
    for row in rows:
        record: dict[str, Any] = {"method": row.method}
        record |= dict.fromkeys(("error", "ratio", "ratio_low", "ratio_high"), np.nan)
        if row.errors is not None:
            own = sums[row.method]
            sampled = _ratio(own[draws].sum(axis=1), reference[draws].sum(axis=1))
            low, high = (
                np.quantile(sampled, [0.025, 0.975], method="inverted_cdf") if enough else (np.nan, np.nan)
            )
            record["error"] = float(np.sqrt(own.sum() / row.errors.size))
            record["ratio"] = float(_ratio(own.sum(), reference.sum()))
            record |= {"ratio_low": float(low), "ratio_high": float(high)}
        record |= {"n_rows": row.n_rows, "note": row.note}
        channels = np.full(len(test.channels), np.nan)
        if row.errors is not None:
            channels = np.sqrt(np.mean(row.errors**2, axis=0))
        records.append(record | dict(zip(test.channels, channels.tolist(), strict=True)))
    return pd.DataFrame(records)


def _ratio(own: ArrayLike, reference: ArrayLike) -> Array:
    """Return the root of the ratio of squared errors; 1 where both are zero."""
    own, reference = np.asarray(own, dtype=float), np.asarray(reference, dtype=float)
    return np.asarray(
        np.sqrt(np.where(own == reference, 1.0, own / np.where(reference > 0, reference, 1e-300)))
    )
