"""Simulators by name."""

import difflib
from collections.abc import Callable
from functools import partial

from skat.simulators.base import Simulator
from skat.simulators.machines import MACHINES, make_machine
from skat.simulators.puck import CONDITIONS as PUCK_CONDITIONS
from skat.simulators.puck import make_puck
from skat.simulators.robots import CONDITIONS as ROBOT_CONDITIONS
from skat.simulators.robots import ROBOTS, make_robot


def make_simulator(name: str, *, condition: str = "normal") -> Simulator:
    """Return one of the paper's simulators, or a robot of which a measured log is open.

    Parameters
    ----------
    name : str
        "hopper", "halfcheetah", "ant", "puck", "pendulum", "double_pendulum", "ur10", "so101", "go2_air" or "ricmonk".
        A Gymnasium robot, or a stick that strikes a hockey puck; or a real machine, as its published numbers have it.
    condition : str, default="normal"
        Robots: "normal", "light", "heavy", "long", "short", "some_inverted", "inverted", "some_off" (Table I
        of the paper). Puck: "normal", or one of the eleven simulations of the paper's table: "isotr_low",
        "isotr_lowmed", "isotr_med", "isotr_medhi", "isotr_high", "isotr_low_offc", "isotr_high_offc",
        "heavy_anisotr_lowx", "heavy_anisotr_lowy", "low_anisotr_lowx", "low_anisotr_lowy". Real machines: "normal".

    Returns
    -------
    Simulator

    Raises
    ------
    ValueError
        If there is no such simulator or condition.

    References
    ----------
    .. [1] Mallasto et al. (2021). Affine Transport for Sim-to-Real Domain Adaptation. Section V.

    Examples
    --------
    >>> from skat.simulators import make_simulator
    >>> make_simulator("hopper", condition="heavy")
    MujocoSimulator('hopper', frame_skip=4, built_in={'mass[all]': 2.0})
    """
    makers: dict[str, tuple[Callable[[str], Simulator], tuple[str, ...]]] = {
        **{robot: (partial(make_robot, robot), ROBOT_CONDITIONS) for robot in ROBOTS},
        "puck": (make_puck, PUCK_CONDITIONS),
        **{machine: (partial(make_machine, machine), ("normal",)) for machine in MACHINES},
    }
    _require_known("simulator", name, tuple(makers))
    make, conditions = makers[name]
    _require_known(f"condition of {name}", condition, conditions)
    return make(condition)


def _require_known(what: str, name: str, names: tuple[str, ...]) -> None:
    if name not in names:
        close = difflib.get_close_matches(str(name), names, n=2)
        hint = f" Did you mean {' or '.join(map(repr, close))}?" if close else ""
        raise ValueError(f"unknown {what} {name!r}.{hint} There are: {', '.join(names)}")
