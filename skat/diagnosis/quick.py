"""Where a first look begins: the part of a log that it takes, and what the forces of the whole log ask for."""

from collections.abc import Mapping, Sequence

import numpy as np

from skat.diagnosis.filtering import Array
from skat.diagnosis.fitting import settled
from skat.diagnosis.force_space import first_look, seen_effects
from skat.diagnosis.log import Log
from skat.diagnosis.statespace import StateSpace
from skat.effects import Effect

# Rows that a first look fits, in stretches of so many; and those from which forces are taken.
QUICK_ROWS, STRETCH = 192, 32
FORCE_ROWS, FORCE_STRETCH = 20_000, 1_000


def where_to_begin(
    space: StateSpace,
    log: Log,
    effects: Sequence[Effect],
    floor: Array,
    *,
    typical: Mapping[str, float] | None = None,
    alpha: float = 0.01,
    given: Array | None = None,
) -> tuple[list[Effect], dict[str, float]]:
    """Return the effects to search among, and the values to begin with.

    Regression in force space takes all rows of a log in a second or two and no step of the simulation, but smoothed
    motion and commands that hold for a row make it err. What it names is believed where it makes some rows of the log
    likelier than the model as it is; then only that, what may stand in its place, and what forces do not show is
    searched for.

    Parameters
    ----------
    space : StateSpace
        Of the rows that are fitted.
    log : Log
        Whose forces are taken.
    effects : sequence of Effect
    floor : ndarray of shape (d,)
        Least variance of each channel's noise.
    typical, alpha, given
        As in `find_causes`.

    Returns
    -------
    list of Effect, dict of str to float
        All effects and no value where forces tell nothing that can be believed.
    """
    everything = list(effects), dict[str, float]()
    if not log.consecutive:
        return everything
    log = log.few(FORCE_ROWS, FORCE_STRETCH)
    look = first_look(space.simulator, log.X, log.y, log.episodes, effects, typical=typical, alpha=alpha)
    if look is None or not look.values:
        return everything
    neutral = settled(space, {}, None, floor, turns=1, given=given).bound
    try:
        there = settled(space, look.values, None, floor, turns=1, given=given).bound
    except RuntimeError:  # it diverges everywhere
        return everything
    if there < neutral - np.log(alpha):
        return everything
    told = {*look.values, *(name for others in look.aliases.values() for name, _ in others)}
    told |= {effect.name for effect in effects} - {effect.name for effect in seen_effects(effects)}
    return [effect for effect in effects if effect.name in told], look.values
