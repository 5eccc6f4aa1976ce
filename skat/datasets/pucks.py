"""Simulated measurements: pucks struck by a stick, in worlds that differ from the puck simulator."""

from typing import Any

import numpy as np
from sklearn.utils import Bunch, check_array, check_random_state

from skat.datasets._worlds import HIDDEN, REAL, shoot

DESCR = """\
Hidden puck: shots of a hockey puck, simulated, in a world that differs from `make_simulator("puck")`

A stick strikes a puck, which slides and comes to rest. `data` holds the commands (z0, z1) of the strikes,
`target` where the puck was found, in m. The world is a MuJoCo model of its own: another time step, something
that differs from the simulator (`truth`, `truth_sentence`), and 0.01 m of noise on each axis.
"""


def make_hidden_puck(
    n_shots: int = 120, *, effect: tuple[str, float] | None = None, random_state: Any = None
) -> Bunch:
    """Strike a puck in a world that hides something from the simulator.

    Parameters
    ----------
    n_shots : int, default=120
        Number of strikes; their commands are drawn from the standard normal distribution.

    effect : str, default=None
        What is hidden: "slope", "friction", "grain", "heavy puck", or "nothing". None draws one of the first
        four.

    random_state : int, RandomState or None, default=None
        Draws the effect, the commands and the noise.

    Returns
    -------
    Bunch
        With these attributes:

        data : ndarray of shape (n_shots, 2)
            Commands z0, z1 of the strikes.
        target : ndarray of shape (n_shots, 2)
            Resting places x, y in m.
        groups : None
            Shots are independent of each other.
        feature_names, target_names : list of str
            Names of the columns.
        units : dict of str to str
            Unit of each name.
        truth : dict of str to float
            What is hidden, in skat's names of effects. Of effects that no shot can tell apart, it is one.
        truth_sentence : str
            What is hidden.
        DESCR : str
            What was done.

    Raises
    ------
    ValueError
        If there is no such effect, or no shot.

    Examples
    --------
    >>> from skat.datasets import make_hidden_puck
    >>> shots = make_hidden_puck(5, effect="slope", random_state=0)
    >>> shots.data.shape, shots.target.shape
    ((5, 2), (5, 2))
    >>> shots.truth
    {'tilt[y]': 0.012}
    """
    if n_shots < 1:
        raise ValueError(f"n_shots={n_shots}; expected at least one.")
    random_state = check_random_state(random_state)
    if effect is None:
        names = [name for name, (_, truth, _) in HIDDEN.items() if truth]
        effect = names[random_state.randint(len(names))]
    if effect not in HIDDEN:
        raise ValueError(f"There is no hidden effect {effect!r}. There are: {', '.join(HIDDEN)}.")
    world, truth, sentence = HIDDEN[effect]
    commands = random_state.standard_normal((n_shots, 2))
    return Bunch(
        data=commands,
        target=shoot(world, commands, random_state),
        truth=dict(truth),
        truth_sentence=sentence,
        DESCR=DESCR,
        groups=None,
        feature_names=["z0", "z1"],
        target_names=["x", "y"],
        units={"z0": "", "z1": "", "x": "m", "y": "m"},
    )


def make_real_puck(colour: str, z: Any, *, random_state: Any = None) -> Bunch:
    """Strike one of two pucks that stand for real ones.

    The recordings of real pucks in the paper [1]_ are not public. These are simulations: a finer time step,
    other friction and mass, a table that slopes slightly, and 0.05 m of noise between strikes on each axis.
    Nothing else in skat knows their numbers, which were fixed before any estimator was run on them.

    Parameters
    ----------
    colour : {"blue", "red"}
        Which puck.

    z : array-like of shape (n_shots, 2)
        Commands of the strikes, as `make_simulator("puck")` takes them.

    random_state : int, RandomState or None, default=None
        Draws the noise.

    Returns
    -------
    ndarray of shape (n_shots, 2)
        Resting places x, y in m.

    Raises
    ------
    ValueError
        If there is no such puck, or `z` has another shape.

    References
    ----------
    .. [1] A. Mallasto, K. Arndt, M. Heinonen, S. Kaski, V. Kyrki (2021). Affine Transport for Sim-to-Real
       Domain Adaptation.

    Examples
    --------
    >>> from skat.datasets import make_real_puck
    >>> make_real_puck("blue", [[0.0, 0.0]], random_state=0).shape
    (1, 2)
    """
    if colour not in REAL:
        raise ValueError(f"There is no {colour!r} puck. There are: {', '.join(REAL)}.")
    z = check_array(z, dtype=np.float64)
    if z.shape[1] != 2:
        raise ValueError(f"z has {z.shape[1]} columns; expected two, z0 and z1.")
    return shoot(REAL[colour], z, check_random_state(random_state))
