"""The search: sets of changes, weighed with all that is common to both logs, and all misfit, integrated out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from skat.diagnosis.chains import Array
from skat.diagnosis.changes.candidates import priors_of, rivals_of, units_of
from skat.diagnosis.changes.mixups import mistake_of
from skat.diagnosis.changes.question import FAULT, MOST, TURNS, Question, question_of
from skat.diagnosis.changes.strengths import Logs, OverStrengths
from skat.diagnosis.changes.telling import Changes, causes_of, detectable_of, gain_of, sizes_of
from skat.diagnosis.changes.windows import total, windows_of
from skat.diagnosis.evidence import Priors, Weighed, bounded_solution
from skat.diagnosis.findings import Cause, Gain
from skat.diagnosis.forces.machines import MOTORS, WEAKEST, Candidate
from skat.diagnosis.forces.motions import Log, motion_of
from skat.diagnosis.forces.start import with_possible_servos
from skat.diagnosis.search import without_weak
from skat.effects import Effect
from skat.simulators import MujocoSimulator, Simulator


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
    try:
        halves = [motion_of(simulator, log, name) for name, log in (("before", before), ("after", after))]
    except ValueError as error:
        raise ValueError(
            f"{error} Or fit the log before, and diagnose the log after with extended_simulator_."
        ) from None
    needed = -np.log(alpha)
    simulator, effects, _ = with_possible_servos(simulator, halves[0], effects)
    question = question_of(
        simulator, halves, effects, typical=typical or {}, test_size=test_size, needed=needed
    )
    found = _searched(question, needed)
    # A motor that died is a fault, too.
    price = found.worth.price(found.best.members) - len(question.weak) * np.log(FAULT)
    mistake, odds = mistake_of(question, found.differences, price=price, needed=needed)
    if odds > needed:
        return _unexplained(question, found.level, None, _as_if(mistake), mistake)
    for _ in range(TURNS):
        if not found.best.members:
            break
        about = question.about(found.value, found.differences)
        last, again = found, _searched(about, needed)
        if not set(again.best.members) <= set(last.best.members):
            now, then = question.lacking([(one.value, one.differences) for one in (again, last)])
            if now > then:
                # Another set, with which the machine lacks more.
                break
        question, found = about, again
        if again.best.members == last.best.members:
            break
    best, worth, differences, value = found.best, found.worth, found.differences, found.value
    causes = causes_of(question, best, worth, found.nats)
    gain = gain_of(question, value, differences)
    reason = ""
    # On windows that were not used the logs differ by something else, or they differ by more than misfit and changes.
    if causes and gain is not None and gain.nominal > gain.floor and gain.explained < MOST:
        told = ", ".join(one.name for one in causes)
        reason = f"The logs differ as if by {told}, but that explains too little of parts of the log after not used."
    elif worth.logs.differ_beyond_misfit(best.evidence, needed):
        reason = "The logs differ by more than what the model misses in both, and by no effect that was asked about."
    if question.weak and (reason or not causes or _contradict(causes, question.weak)):
        told = (
            " and ".join(question.weak) + " were next to nothing: a motor that died, or a joint that is stuck"
        )
        mistake = f"{mistake}, or {told}" if odds > -needed else told
        return _unexplained(question, value, gain, _as_if(mistake), mistake)
    if reason:
        return _unexplained(question, value, gain, reason)
    sizes = sizes_of(question, value)
    if not causes:
        return Changes((), "nothing changed", gain, sizes, detectable=detectable_of(question, worth, needed))
    ambiguous = any(cause.aliases for cause in causes)
    return Changes(causes, "ambiguous" if ambiguous else "named", gain, sizes)


def _unexplained(
    question: Question, value: Array, gain: Gain | None, reason: str, mistake: str = ""
) -> Changes:
    return Changes((), "unexplained", gain, sizes_of(question, value), mistake, reason)


def _as_if(mistake: str) -> str:
    return f"The log after reads as if {mistake}."


def _contradict(causes: Sequence[Cause], weak: Sequence[str]) -> bool:
    """Return whether a motor that does next to nothing is told to do more: rows are about another machine then."""
    return any(
        one.name in weak and (one.interval[0] > WEAKEST or one.interval[1] < -WEAKEST) for one in causes
    )


@dataclass(frozen=True)
class _Found:
    """What a search found.

    Attributes
    ----------
    best : Weighed
        The set that is named; its values are in units of scales.
    worth : OverStrengths
    nats : mapping from place to float
        What each member is worth.
    differences : ndarray of shape (n_candidates,)
        In units of scales.
    level, value : ndarray of shape (n_effects,)
        What is common if nothing changed, and beside the differences, of what a machine may have, in units of sizes.
    """

    best: Weighed
    worth: OverStrengths
    nats: Mapping[int, float]
    differences: Array
    level: Array
    value: Array


def _searched(question: Question, needed: float) -> _Found:
    """Return the likeliest set of changes that a machine may have."""
    priors, logs = priors_of(question.candidates, question.scales, question.simulator.dt), _logs(question)
    while True:
        worth = OverStrengths(logs, priors, rivals_of(question.candidates))
        best, nats = without_weak(worth.best(needed), worth, needed)
        differences = np.zeros(len(question.candidates))
        differences[list(best.members)] = best.values
        level, value = _common(logs, worth.strength(best.members), differences, question.possible())
        absurd = [*_at_bounds(best, question.candidates, priors), *_impossible(best, question, value)]
        if not absurd:
            return _Found(best, worth, nats, differences, level, value)
        log_odds = priors.log_odds.copy()
        log_odds[absurd] = -np.inf
        priors = replace(priors, log_odds=log_odds)


def _logs(question: Question) -> Logs:
    """Return both logs without the windows that are held out."""
    law, kept, (before, after) = question.law, ~question.held_out, question.sides
    k, late = len(question.effects), np.array([bool(one.late) for one in question.candidates], dtype=bool)
    own, changed = after.columns[:, :k], after.columns[:, k:]
    before = replace(before, columns=np.column_stack([before.columns, question.later]))
    after = replace(after, columns=np.column_stack([own, changed[:, late], changed]))
    sides = (before, law.noise[0]), (after.part(kept), law.noise[1][kept])
    first, second = (windows_of(*side, law.spread) for side in sides)
    return Logs(total(first), total(second), law, first, second)


def _common(
    logs: Logs, strength: float, differences: Array, ends: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return what is common where logs differ by a strength: if nothing changed, and beside differences.

    ``ends`` as of `Machines.possible`.
    """
    weights, both = logs.weights, logs.both(strength)
    k, n = len(weights), len(logs.law.weights)
    H, given = both.products[:k, :k] + np.diag(weights), both.products[:k, k:] @ differences
    low, high = (np.r_[end, np.full(k - n, beyond)] for end, beyond in zip(ends, (-np.inf, np.inf)))
    level, value = (
        bounded_solution(H, right, low, high, np.zeros(k))[:n]
        for right in (both.projections[:k], both.projections[:k] - given)
    )
    return level, value


def _at_bounds(best: Weighed, candidates: Sequence[Candidate], priors: Priors) -> list[int]:
    """Return the members at an end of what is possible: a sign that something else is behind them."""
    return [
        place
        for place, value in zip(best.members, best.values)
        if not candidates[place].late and priors.is_held(place, value)
    ]


def _impossible(best: Weighed, question: Question, value: Array) -> list[int]:
    """Return the members that no machine can have in the second log: a friction, with what is common, below zero.

    Beyond their errors; ``value`` (n_effects,) is what is common, in units of sizes. Motors may turn the other way, and
    of a weight that is taken off the model knows nothing.
    """
    found, scales = [], question.scales * units_of(question.candidates, question.machine)
    for place, difference, half in zip(best.members, best.values, best.half_widths):
        one, scale = question.candidates[place], scales[place]
        if one.late or one.effect.family in MOTORS:
            continue
        for effect, size, common in zip(question.effects, question.sizes, value):
            if effect.family != one.effect.family or one.effect.target not in (effect.target, "all"):
                continue
            after = question.base.values.get(effect.name, effect.neutral) + size * common + scale * difference
            if not effect.bounds[0] - scale * half <= after <= effect.bounds[1] + scale * half:
                found.append(place)
                break
    return found
