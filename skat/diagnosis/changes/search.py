"""The search: sets of changes, weighed over drawn windows with all that is common to both logs integrated out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.changes.candidates import Candidate, priors_of, rivals_of
from skat.diagnosis.changes.mixups import mistake_of
from skat.diagnosis.changes.motions import Log, half_of
from skat.diagnosis.changes.question import Question, question_of
from skat.diagnosis.changes.telling import Changes, causes_of, gain_of, sizes_of
from skat.diagnosis.changes.windows import Bagged, Windows, drawn_windows, integrated
from skat.diagnosis.evidence import Gram, Priors, Weighed
from skat.diagnosis.filtering import Array
from skat.diagnosis.search import search_sets, without_weak
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator

# Sets of the search of both logs that each pair of drawn ones is asked for.
POOL = 32
# Log odds of what is not named, and the share of its range from neutral that a value keeps to.
NEVER, INSIDE = -1e6, 1 - 1e-6


def find_changes(
    simulator: Simulator,
    before: Log,
    after: Log,
    effects: Sequence[Effect],
    *,
    typical: Mapping[str, float] | None = None,
    alpha: float = 0.01,
    test_size: float = 0.3,
) -> Changes:
    """Return in what two logs of one machine differ.

    Parameters
    ----------
    simulator : Simulator
    before, after : tuple of (X, y, groups)
        Rows of an episode follow each other. NaN in states where nothing was measured.
    effects : sequence of Effect
        That may be wrong in the model or may have changed; weights on bodies are tried beside them.
    typical : mapping from name to size, optional
        Scales of the priors of a user's own.
    alpha : float, default=0.01
        A change is named if the odds for the set with it are 1 / alpha times those of the set without.
    test_size : float, default=0.3
        Share of the second log that measures the gain.

    Returns
    -------
    Changes

    Raises
    ------
    ValueError
        If the simulator is not one of joints, a joint was not measured, or contacts push all the time.
    """
    if not isinstance(simulator, MujocoSimulator):
        raise ValueError(
            "changes are searched for in the forces on joints, of which a function knows nothing: the simulator must "
            f"be a MujocoSimulator; it is {simulator!r}. Instead, fit the log before, and diagnose the log after with "
            "extended_simulator_."
        )
    halves = [half_of(simulator, log, name) for name, log in (("before", before), ("after", after))]
    question = question_of(simulator, halves, effects, typical=typical or {}, test_size=test_size)
    priors, needed = priors_of(question.candidates, question.scales, simulator.dt), -np.log(alpha)
    sides = _integrated_sides(question)
    gram, common = _differences(question, sides)
    drawn = drawn_windows(sides)
    while True:
        worth = _bagged(question, sides, drawn, gram, priors)
        # Of any two sets, that with more names must be worth what they need.
        best = max(worth.seen.values(), key=lambda one: one.evidence - needed * len(one.members))
        best, nats = without_weak(best, worth, needed)
        absurd = _at_bounds(best, question.candidates, priors)
        if not absurd:
            break
        log_odds = priors.log_odds.copy()
        log_odds[absurd] = NEVER
        priors = replace(priors, log_odds=log_odds)
    differences = np.zeros(len(question.candidates))
    differences[list(best.members)] = best.values
    ours = worth.whole(best.members)
    price = ours.likelihood - ours.evidence
    mistake = mistake_of(question, differences, common.alone, drawn, price=price, needed=needed)
    if mistake:
        return Changes((), "unexplained", None, sizes_of(question, common.level), mistake)
    causes = causes_of(question, best, worth, nats)
    verdict = "nothing changed" if not causes else "named"
    if any(cause.aliases for cause in causes):
        verdict = "ambiguous"
    value = common.level - common.slopes @ differences
    gain = gain_of(question, value, differences)
    return Changes(causes, verdict, gain, sizes_of(question, value))


@dataclass(frozen=True)
class _Common:
    """What is common: beside differences from neutral it is ``level - slopes @ differences``.

    Attributes
    ----------
    level : ndarray of shape (n_effects,)
        In units of typical sizes, as are all.
    slopes : ndarray of shape (n_effects, n_candidates)
    alone : ndarray of shape (n_effects,)
        By the first log alone.
    """

    level: Array
    slopes: Array
    alone: Array


def _integrated_sides(question: Question) -> tuple[Windows, Windows]:
    """Return the windows of the first log, and those of the second that fit, without effects of their own."""
    law, kept = question.law, ~question.held_out
    rows = question.sides[0], question.sides[1].part(kept)
    first, second = (
        Windows.of(side, noise).without(law.spread)
        for side, noise in zip(rows, (law.noise[0], law.noise[1][kept]))
    )
    return first, second


def _differences(
    question: Question, sides: tuple[Windows, Windows], times: Sequence[Array] | None = None
) -> tuple[Gram, _Common]:
    """Return the Gram matrix of differences with all else integrated out, and what is common given them.

    ``times`` says how often each window of either log counts; once, by default.
    """
    law, k = question.law, len(question.effects)
    (G, h), second = (
        (side.every() if times is None else side.drawn(times[place])) for place, side in enumerate(sides)
    )
    products, projections = integrated(*second, np.arange(k), 1 / law.apart)
    H = products[:k, :k] + G + np.diag(law.weights)
    right = np.column_stack([projections[:k] + h, products[:k, k:]])
    solved = np.linalg.solve(H, right)
    cross = products[k:, :k]
    gram = Gram(
        products[k:, k:] - cross @ solved[:, 1:],
        projections[k:] - cross @ solved[:, 0],
        np.zeros(len(question.candidates)),
    )
    alone = np.linalg.solve(G + np.diag(law.weights), h)
    return gram, _Common(*(np.asarray(one, dtype=float) for one in (solved[:, 0], solved[:, 1:], alone)))


def _bagged(
    question: Question,
    sides: tuple[Windows, Windows],
    drawn: Sequence[tuple[Array, ...]],
    gram: Gram,
    priors: Priors,
) -> Bagged:
    """Return the worth of sets over drawn windows; the likely ones of both logs and the best of each pair are seen."""
    rivals = rivals_of(question.candidates)
    best, whole = search_sets(gram, priors, rivals=rivals)
    pool = sorted(whole.seen, key=lambda members: -whole.seen[members].evidence)[:POOL]
    found = [
        search_sets(_differences(question, sides, times)[0], priors, start=best.members, rivals=rivals)
        for times in drawn
    ]
    likely = list(dict.fromkeys([(), *pool, *(one.members for one, _ in found)]))
    worth = Bagged(whole, [one for _, one in found], likely)
    for members in likely:
        worth(members)
    return worth


def _at_bounds(best: Weighed, candidates: Sequence[Candidate], priors: Priors) -> list[int]:
    """Return the members at an end of what is possible: a sign that something else is behind them."""
    return [
        place
        for place, value in zip(best.members, best.values)
        if not candidates[place].late and not priors.low[place] * INSIDE < value < priors.high[place] * INSIDE
    ]
