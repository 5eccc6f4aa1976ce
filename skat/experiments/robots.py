"""The paper's Gymnasium experiment: every method between every two of eight worlds of a robot."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from sklearn.utils import check_random_state

from skat.experiments.methods import METHODS, chosen_methods, fitted_transport, of_repeat
from skat.experiments.scores import affinity_of_first, covariance_errors, pointwise_errors
from skat.simulators import Simulator, make_simulator
from skat.simulators.robots import CONDITIONS

N_STEPS = 50
COVARIANCE_MEASURES = (
    "covariance_error",
    "covariance_error_raw",
    "covariance_error_affine",
    "normal_distance",
    "normal_distance_raw",
)
MEASURES = ("error_before", "rho", "error_after", "triplet_error", *COVARIANCE_MEASURES)


@dataclass(frozen=True)
class Start:
    """How Gymnasium's version 5 of a robot starts an episode.

    Attributes
    ----------
    pose : mapping from channel to value
        What is not zero in the reference pose; m, and 1 for quaternions.
    noise : float
        Half the width of the uniform noise on qpos; m and rad.
    normal_speeds : bool
        Whether the noise on qvel is normal, of this standard deviation, rather than uniform; m/s and rad/s.
    world : tuple of str
        Places in the world, which the rows leave out: nothing depends on them.
    """

    pose: Mapping[str, float]
    noise: float
    normal_speeds: bool
    world: tuple[str, ...]


STARTS = {
    "hopper": Start({"qpos.rootz": 1.25}, 0.005, False, ("qpos.rootx",)),
    "halfcheetah": Start({}, 0.1, True, ("qpos.rootx",)),
    "ant": Start({"qpos.root.z": 0.75, "qpos.root.qw": 1.0}, 0.1, True, ("qpos.root.x", "qpos.root.y")),
}


@dataclass(frozen=True, eq=False)
class Replay:
    """States and actions of the normal world, and what followed them in every world.

    Attributes
    ----------
    simulators : dict of str to Simulator
        By condition.
    X : ndarray of shape (n_rows, n_inputs)
        Full states and actions.
    y : dict of str to ndarray of shape (n_rows, n_outputs)
        Next full states, by condition.
    groups : ndarray of shape (n_rows,)
        Episode of each row.
    n_world : int
        Number of leading columns that are places in the world.
    """

    simulators: dict[str, Simulator]
    X: np.ndarray
    y: dict[str, np.ndarray]
    groups: np.ndarray
    n_world: int

    @property
    def context(self) -> int:
        """Number of columns of state and action in a row, which are the same in every world."""
        return int(self.X.shape[1] - self.n_world)

    def rows(self, condition: str) -> np.ndarray:
        """Return rows (state, action, next state) without places in the world.

        Parameters
        ----------
        condition : str

        Returns
        -------
        ndarray of shape (n_rows, n_features)
        """
        return np.hstack([self.X[:, self.n_world :], self.y[condition][:, self.n_world :]])


def replay_transitions(
    robot: str, *, n_transitions: int, conditions: Sequence[str] = CONDITIONS, random_state: Any = 0
) -> Replay:
    """Drive a robot by random torques in the normal world, and replay each transition in the others.

    Parameters
    ----------
    robot : {"hopper", "halfcheetah", "ant"}
    n_transitions : int
        Number of rows. Episodes have 50 steps and start as Gymnasium's do; torques are uniform over the
        actuators' range.
    conditions : sequence of str
        Worlds to replay in.
    random_state : int, RandomState instance or None, default=0

    Returns
    -------
    Replay

    Raises
    ------
    ValueError
        If there is no such robot or condition.
    """
    if robot not in STARTS:
        raise ValueError(f"unknown robot {robot!r}. There are: {', '.join(STARTS)}")
    rng = check_random_state(random_state)
    simulators = {condition: make_simulator(robot, condition=condition) for condition in conditions}
    normal = make_simulator(robot)
    n_episodes = -(-n_transitions // N_STEPS)
    starts = _starts(normal, STARTS[robot], n_episodes, rng)
    torques = rng.uniform(-1.0, 1.0, (n_episodes, N_STEPS, len(normal.input_names) - len(normal.state_names)))
    states = normal.rollout(starts, torques, n_steps=N_STEPS)[:, :-1]
    X = np.concatenate([states, torques], axis=2).reshape(-1, len(normal.input_names))[:n_transitions]
    return Replay(
        simulators,
        X,
        {condition: simulator.predict(X) for condition, simulator in simulators.items()},
        np.repeat(np.arange(n_episodes), N_STEPS)[:n_transitions],
        len(STARTS[robot].world),
    )


def domain_matrix(
    robot: str,
    *,
    n_transitions: int = 2000,
    methods: Any = None,
    random_state: Any = 0,
    n_repeats: int = 3,
    n_test: int = 2000,
    n_scored: int = 500,
    split: Any = "rows",
    conditions: Sequence[str] = CONDITIONS,
    sources: Any = None,
    n_jobs: Any = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> pd.DataFrame:
    """Carry transitions between every two of a robot's worlds, by every method.

    Random torques drive the robot in the normal world in episodes of 50 steps; every state and action is
    replayed in all worlds. Rows are (state, action, next state) without places in the world: 25 columns for
    Hopper, 40 for HalfCheetah, 62 for Ant, whose state holds a quaternion as it is. Maps act on whole rows.

    Parameters
    ----------
    robot : {"hopper", "halfcheetah", "ant"}
    n_transitions : int, default=2000
        Rows to fit on. Methods whose name has "disjoint" see one half from the source and the other half from
        the target.
    methods : list of str, or dict of str to transport, default=None
        Names of methods, or transports of your own. None: all but "diagnosis", which takes half a minute or
        more for each pair of worlds. It knows the source's simulator, sees the rows of the target, and
        predicts by the simulator that it extended.
    random_state : int, RandomState instance or None, default=0
    n_repeats : int, default=3
        Times that the experiment is run anew; the table has means and standard deviations. Slow methods, the
        exact transport and the diagnosis, run the first time only.
    n_test : int, default=2000
        Other rows, which all errors are measured on.
    n_scored : int, default=500
        How many of them the affinity score is computed on.
    split : {"rows", "episodes"}, default="rows"
        Whether the rows to test are drawn from all episodes, or are episodes of their own; `n_transitions` is then
        a multiple of 50.
    conditions : sequence of str
        Worlds; the paper's Table I by default.
    sources : sequence of str, default=None
        Those of them that rows are carried from; all by default.
    n_jobs : int, default=None
        Number of processes.
    progress : callable, default=None
        Called with (stage, done, total).

    Returns
    -------
    DataFrame
        A row for each source, target and method:

        - error_before: mean Euclidean distance between the next states of source and target;
        - rho: affinity score of carried and target rows;
        - error_after: mean distance between carried and target next states;
        - triplet_error: mean distance between carried and target rows, whole triplets (state, action, next state): a
          map of triplets moves state and action as well, which are the same in both worlds, and a conditional map
          does not. Nothing is to be moved there, so that its "before" is error_before;
        - covariance_error: Frobenius distance between the covariances of carried and target next states, each
          column in standard deviations of the target's, over the norm of the latter's covariance;
        - covariance_error_raw: the same in the columns' units;
        - covariance_error_affine: the same after whitening by the target's covariance;
        - normal_distance, normal_distance_raw: squared 2-Wasserstein distance of the normals of the same means
          and covariances, over the variance of the target's, of columns as in the first two;
        - each of these names with ``_std``: standard deviation over the repeats (NaN for one).

        Errors are over columns in m, rad, m/s, rad/s as they are, where speeds are the larger numbers.

    Raises
    ------
    ValueError
        If there is no such robot, condition, source, method or split; with fewer than two conditions.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section V.A.

    Examples
    --------
    >>> from skat.experiments import domain_matrix
    >>> table = domain_matrix("hopper", n_transitions=200, n_test=200, n_repeats=1, n_scored=50,
    ...                       methods=["affine", "procrustes_whitened"], conditions=["normal", "heavy"])
    >>> table[["source", "target", "method"]]
       source  target               method
    0  normal   heavy               affine
    1  normal   heavy  procrustes_whitened
    2   heavy  normal               affine
    3   heavy  normal  procrustes_whitened
    >>> bool((table.error_after < table.error_before).all())
    True
    """
    if split not in ("rows", "episodes"):
        raise ValueError(f'split must be "rows" or "episodes"; it is {split!r}.')
    if split == "episodes" and n_transitions % N_STEPS:
        raise ValueError(
            f'split="episodes" tests on other episodes than it fits on, which are of {N_STEPS} rows: n_transitions '
            f"must be a multiple of that; it is {n_transitions}."
        )
    if len(conditions) < 2:
        raise ValueError(
            f"a matrix needs two worlds or more; conditions has {len(conditions)}: {list(conditions)}."
        )
    sources = list(conditions if sources is None else sources)
    if not sources or not set(sources) <= set(conditions):
        raise ValueError(f"sources must be some of the conditions, {list(conditions)}; it is {sources}.")
    chosen = chosen_methods(methods, METHODS)
    rng = check_random_state(random_state)
    report = progress or _silent
    pairs = [(source, target) for source in sources for target in conditions if source != target]
    records = []
    for repeat in range(n_repeats):
        report("simulating", repeat, n_repeats)
        replay = replay_transitions(
            robot, n_transitions=n_transitions + n_test, conditions=conditions, random_state=rng
        )
        order = rng.permutation(len(replay.X)) if split == "rows" else np.arange(len(replay.X))
        fitted, tested = order[:n_transitions], order[n_transitions:]
        report("simulating", repeat + 1, n_repeats)
        now, seed, done = of_repeat(chosen, repeat), rng.randint(2**31), repeat * len(pairs)
        tasks = (delayed(_compared)(replay, *pair, now, fitted, tested, n_scored, seed) for pair in pairs)
        report("carrying", done, n_repeats * len(pairs))
        for number, measures in enumerate(Parallel(n_jobs, return_as="generator")(tasks), start=1):
            records += measures
            report("carrying", done + number, n_repeats * len(pairs))
    return _over_repeats(pd.DataFrame(records))


def _compared(
    replay: Replay,
    source: str,
    target: str,
    chosen: Mapping[str, Any],
    fitted: Any,
    tested: Any,
    n_scored: int,
    seed: int,
) -> Any:
    """Return the measures of each method for one pair of worlds."""
    source_rows, target_rows = replay.rows(source), replay.rows(target)
    expected = target_rows[tested]
    before = pointwise_errors(source_rows[tested], expected, replay.context).mean()
    records = []
    for name, method in chosen.items():
        if method is None:
            carried = _diagnosed(replay, source, target, fitted, tested, seed)
        else:
            transport = fitted_transport(method, source_rows[fitted], target_rows[fitted], replay.context)
            carried = transport.transform(source_rows[tested])
        records.append(
            {
                "source": source,
                "target": target,
                "method": name,
                "error_before": before,
                "rho": affinity_of_first(carried, expected, n_scored),
                "error_after": pointwise_errors(carried, expected, replay.context).mean(),
                "triplet_error": pointwise_errors(carried, expected, 0).mean(),
                **covariance_errors(carried, expected, replay.context),
            }
        )
    return records


def _diagnosed(replay: Replay, source: str, target: str, fitted: Any, tested: Any, seed: int) -> Any:
    """Return the tested rows as the source's simulator predicts them once the target's rows extended it."""
    from skat.diagnosis import SimulationDiagnosis

    # Rows without groups: a replayed row does not begin where the one before it has ended.
    fitted = np.sort(fitted)
    diagnosis = SimulationDiagnosis(replay.simulators[source], test_size=0, random_state=seed)
    diagnosis.fit(replay.X[fitted], replay.y[target][fitted])
    outcome = diagnosis.extended_simulator_.predict(replay.X[tested])
    return np.hstack([replay.X[tested][:, replay.n_world :], outcome[:, replay.n_world :]])


def _starts(simulator: Any, start: Start, n_episodes: int, rng: Any) -> Any:
    names = simulator.state_names
    n_positions = sum(name.startswith("qpos.") for name in names)
    shape = (n_episodes, len(names) - n_positions)
    states = np.tile([start.pose.get(name, 0.0) for name in names], (n_episodes, 1))
    states[:, :n_positions] += rng.uniform(-start.noise, start.noise, (n_episodes, n_positions))
    speeds = (
        rng.normal(0.0, start.noise, shape)
        if start.normal_speeds
        else rng.uniform(-start.noise, start.noise, shape)
    )
    states[:, n_positions:] += speeds
    # A displacement of zero normalises quaternions.
    return simulator.displace(states, np.zeros((n_episodes, len(simulator.residual_names))))


def _over_repeats(records: pd.DataFrame) -> Any:
    """Return means over repeats with the standard deviations of the measures beside them."""
    groups = records.groupby(["source", "target", "method"], sort=False)
    means = groups[list(MEASURES)].mean()
    deviations = groups[list(MEASURES)].std().add_suffix("_std")
    return means.join(deviations).reset_index()


def _silent(stage: str, done: int, total: int) -> None:
    """Report to nobody."""
