"""When a log contradicts a simulator: usual mistakes in columns, and the error that each would leave if mended."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Suspect:
    """A repair of a log that was tried.

    Attributes
    ----------
    kind : str
        "degrees", "sign", "swap", "shift", ...
    sentence : str
        What it would mean, such as "ctrl.a and ctrl.b are swapped".
    error : float
        One-step error as it is, in standard deviations of each channel's change, root mean square over channels.
    repaired : float
        The same with the repair.
    options : dict
        Keyword arguments of `load_log` that make the repair; empty where none does.
    """

    kind: str
    sentence: str
    error: float
    repaired: float
    options: dict


def suspects(simulator, log, *, kinds=None, n_rows=400):
    """Return the repairs that were tried, the most telling first.

    Parameters
    ----------
    simulator : Simulator
    log : Log
    kinds : sequence of str, default=None
        None: all.
    n_rows : int, default=400
        Rows that are simulated.

    Returns
    -------
    list of Suspect
    """
    raise NotImplementedError
