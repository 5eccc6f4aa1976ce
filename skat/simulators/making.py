"""Simulators by name."""

import difflib

from skat.simulators.base import Simulator
from skat.simulators.puck import CONDITIONS as PUCK_CONDITIONS
from skat.simulators.puck import make_puck
from skat.simulators.robots import CONDITIONS as ROBOT_CONDITIONS
from skat.simulators.robots import ROBOTS, make_robot


def make_simulator(name: str, *, condition: str = "normal") -> Simulator:
    """Return one of the paper's simulators.

    Parameters
    ----------
    name : {"hopper", "halfcheetah", "ant", "puck"}
        A Gymnasium robot, or a stick that strikes a hockey puck.
    condition : str, default="normal"
        Robots: "normal", "light", "heavy", "long", "short", "some_inverted", "inverted", "some_off" (Table I
        of the paper). Puck: "normal", or one of the eleven simulations of the paper's table: "isotr_low",
        "isotr_lowmed", "isotr_med", "isotr_medhi", "isotr_high", "isotr_low_offc", "isotr_high_offc",
        "heavy_anisotr_lowx", "heavy_anisotr_lowy", "low_anisotr_lowx", "low_anisotr_lowy".

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
    _require_known("simulator", name, (*ROBOTS, "puck"))
    _require_known(f"condition of {name}", condition, PUCK_CONDITIONS if name == "puck" else ROBOT_CONDITIONS)
    return make_puck(condition) if name == "puck" else make_robot(name, condition)


def _require_known(what: str, name: str, names: tuple[str, ...]) -> None:
    if name not in names:
        close = difflib.get_close_matches(str(name), names, n=2)
        hint = f" Did you mean {' or '.join(map(repr, close))}?" if close else ""
        raise ValueError(f"unknown {what} {name!r}.{hint} There are: {', '.join(names)}")
