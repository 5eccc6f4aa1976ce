"""Which effects explain the residuals: add the best, exchange what a better one explains, prune what does not stand."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from skat.diagnosis.aliases import find_aliases
from skat.diagnosis.estimates import Estimates
from skat.diagnosis.evidence import (
    as_good,
    fall_p_value,
    family_p_value,
    grams,
    screen,
)
from skat.diagnosis.judgement import Judgement
from skat.diagnosis.proposals import Proposals
from skat.diagnosis.refits import Fit

# Exchanges made, and the fall of the loss in noise units that makes one worth it.
MOST_EXCHANGES = 4
WORTH_AN_EXCHANGE = 1.0
# Another effect explains nearly as much as a named one if it leaves this share of it.
NEARLY = 0.05
# Misfit of the typical row, in noise units, beyond which a derivative says little of what is far away.
FAR_OFF = 2.0
# There a further effect must explain this share of the loss beyond noise: in a log that is like none of the models,
# what explains little may stand for anything.
LEAST_SHARE = 0.1
# An effect on all is taken apart into so many elements at most, where that leaves less than this share of the loss.
MOST_ELEMENTS = 16
APART_LOSS = 0.7
# What explains so much of the loss in noise units, where nothing stands, is judged at the noise that it leaves.
WORTH_ITS_OWN_NOISE = 30.0
# A named effect's value far off, refitted, is taken where the loss falls by this much in noise units; so many times.
WORTH_A_JUMP = 10.0
MOST_JUMPS = 3


@dataclass(frozen=True)
class Refused:
    """An effect that is significant beside a model, but does not improve it throughout the log, or predicts worse.

    Attributes
    ----------
    name : str
    value : float
    loss : float
        In noise units.
    """

    name: str
    value: float
    loss: float


@dataclass(frozen=True)
class Selected:
    """The effects named, with what the decision rests on.

    Attributes
    ----------
    values : dict of str to float
        Most telling first.
    p_values : dict of str to float
        Family-wise, over all effects screened.
    intervals : dict of str to tuple of two floats
        95 %.
    aliases : dict of str to tuple of str
    linearisation : Linearisation
        At the final model.
    gram : Grams
        Of the same, by block.
    refused : Refused or None
        What explains most of what the others leave, and was not named all the same.
    """

    values: dict
    p_values: dict
    intervals: dict
    aliases: dict
    linearisation: object
    gram: object
    refused: Refused | None = None


@dataclass(frozen=True)
class Pruned:
    """What stands of a model.

    Attributes
    ----------
    values : dict of str to float
    line : Linearisation
        There.
    p_values : dict of str to float
        Family-wise, which its effects stand by.
    by_fall : set of str
        Of these, those that stand by the fall of the loss, not by their size.
    """

    values: dict
    line: object
    p_values: dict
    by_fall: set


class Selection:
    """Forward selection with refits and backward pruning.

    Parameters
    ----------
    residuals : Residuals
    names : sequence of str
        Effects to choose from.
    alpha : float
        Chance of naming anything where nothing is wrong.
    max_effects : int
    progress : callable
        ``progress(stage, done, total)``.
    """

    def __init__(self, residuals, names, *, alpha, max_effects, progress):
        self.residuals, self.names = residuals, list(names)
        self.alpha, self.max_effects, self.progress = alpha, max_effects, progress
        self.effects = residuals.effects
        self.estimates = Estimates(residuals, names)
        self.refits = self.estimates.refits
        self.proposals = Proposals(self.estimates)
        self.judgement = Judgement(self.estimates, self.proposals)
        # What was last significant beside a model, and refused.
        self.refused: Refused | None = None
        # Sets of effects that were exchanged for better ones.
        self.left: set[frozenset] = set()
        # Of each set that was exchanged, the one that it was left for.
        self.better: dict[frozenset, frozenset] = {}

    def run(self):
        """Return the Selected effects."""
        values, line, history = self._grown(self.estimates.linearised({}))
        pruned = self._prune(values, line)
        if history and not pruned.values:
            # What was added did not stand: a derivative misled, and the truth may be far off.
            values, line, history = self._grown(pruned.line, far_off=True)
            pruned = self._prune(values, line)
        while True:
            # Averaged values may be less certain than those they are the mean of.
            values, line, spread = self.estimates.averaged(pruned.values, pruned.line)
            pruned = self._prune(values, line, spread)
            if pruned.values.keys() == values.keys():
                return self._result(pruned, spread)

    def _grown(self, line, *, far_off=False):
        """Return the model with all effects that a forward selection adds, its linearisation, and what was added."""
        values: dict[str, float] = {}
        history: list[dict[str, float]] = []
        jumps = 0
        self.left, self.better = set(), {}
        while True:
            self.progress("select", len(values), self.max_effects)
            added = None
            if len(values) < self.max_effects:
                added = self._add(values, line, far_off=far_off and not values) or self._apart(values, line)
            if added is None and jumps < MOST_JUMPS:
                jumps += 1
                jumped = self._jumped(values, line)
                if jumped is not None:
                    history.append(jumped[0])
                    values, line = self._simplified(*jumped)
                    continue
            if added is None:
                break
            history.append(added)
            values, line = self._simplified(*self.estimates.polished(added))
        return values, line, history

    def _jumped(self, values, line):
        """Return the model with one of its values far off, and its linearisation, None if that is no likelier."""
        found = self._elsewhere(values, self.refits.losses(line.residuals).sum(), list(values))
        if found is None:
            return None
        misfit, state = self.refits.misfit(line.residuals), self.residuals.state()
        found, found_line = self.estimates.polished(found)
        if self.refits.is_likelier(found_line.residuals, misfit, WORTH_A_JUMP):
            return found, found_line
        self.residuals.restore(state)
        self.refits.set_scale(line.residuals)
        return None

    def _simplified(self, values, line):
        """Return a model that no exchange of effects makes better, or smaller and as good.

        Where the log is like none of them, each looks better at states smoothed by the other: what an exchange has
        left none comes back to.
        """
        for _ in range(MOST_EXCHANGES if values else 0):
            exchanged, near = self._exchanged(values, line)
            if exchanged is None:
                return self._nearer(values, line, near)
            if frozenset(exchanged) in self.left:
                break
            self.left.add(frozenset(values))
            self.better[frozenset(values)] = frozenset(exchanged)
            values, line = self.estimates.polished(exchanged)
        return values, line

    def _nearer(self, values, line, near):
        """Return the model, or the best that explains nearly as much of the log with another effect in its place.

        Each is judged at states and noise of its own: what a wrong effect leaves may have passed for noise, in which
        the right one shows little. At contacts that changes from one settling to the next by as much, so the other must
        also fit better than the present one does at the same states and noise.
        """
        for other in near:
            if frozenset(other) in self.left:
                continue
            self.left.add(frozenset(other))
            present = self.refits.misfit(line.residuals)
            state = self.residuals.state()
            found, settled = self.estimates.fitted(other)
            residuals = self.refits.whitened([found])[0]
            likelier = self.refits.is_likelier(residuals, present, WORTH_A_JUMP)
            if likelier and self.refits.losses(residuals).sum() < self.refits.fit([values])[0].loss:
                self.better[frozenset(values)] = frozenset(found)
                return found, self.estimates.linearised(found, settled=settled)
            self.residuals.restore(state)
            self.refits.set_scale(line.residuals)
        return values, line

    # -- one effect more -------------------------------------------------------------------------------------------

    def _add(self, values, line, *, far_off=False):
        """Return the values of the model with the best further effect, None if no effect is significant.

        A refit starts from states smoothed by the present model, and may end in a jag of the loss, short of the
        effect's value, where the evidence is weaker than when all effects were screened; so either counts. What is
        added is judged again at states smoothed by its own model, in the end. So is at once what explains much, where
        nothing stands: a sensor's scale may pass for noise of its channel, in which it shows little.
        """
        self.refused = None
        gram = grams(line.residuals, line.derivatives, self.estimates.clusters(len(line.names)))
        first = screen(gram, line.names, values, self.effects, list(values))
        misfit = np.median(np.sum(line.residuals**2, axis=-1)) / line.residuals.shape[1]
        present = self.refits.losses(line.residuals)
        least_explained = 0.0
        if misfit > FAR_OFF:
            far_off, least_explained = True, LEAST_SHARE * (present.sum() - line.residuals.size)
        some_far_off = present.sum() > FAR_OFF * line.residuals.size
        doubtful: list[Fit] = []
        for models in self.proposals.further(values, first, far_off=far_off, some_far_off=some_far_off):
            fits = self.refits.fit(models, race=True)
            for fit in self._ranked(fits, values):
                (new,) = set(fit.values) - set(values)
                screened = min(first.p_values[first.names.index(new)], fall_p_value(present, fit.losses))
                p_value = min(
                    family_p_value(screened, len(self.names)),
                    self.judgement.p_values(fit.values)[new],
                )
                if p_value >= self.alpha:
                    continue
                if (
                    present.sum() - fit.loss > least_explained
                    and self.judgement.improves(fit, present)
                    and self.judgement.predicts(fit.values, values)
                ):
                    self.refused = None
                    better = self._elsewhere(fit.values, fit.loss, [new])
                    return better if better and self.judgement.predicts(better, values) else fit.values
                if self.refused is None or fit.loss < self.refused.loss:
                    self.refused = Refused(new, fit.values[new], fit.loss)
            doubtful += fits
        best = min(doubtful, key=lambda fit: fit.loss, default=None)
        if best is None or present.sum() - best.loss < max(least_explained, WORTH_ITS_OWN_NOISE):
            return None
        found = self._at_its_own_noise(best, values, line)
        if found is not None:
            self.refused = None
        return found

    def _ranked(self, fits, values):
        """Return fits with a further effect, best first; tied ones by the odds of their effects, then as listed.

        They are tied within what an exchange must be worth, so that none undoes the order; rounding decides nothing.
        """
        left, ranked = list(fits), []
        while left:
            best = min(fit.loss for fit in left)
            tied = [fit for fit in left if fit.loss <= best + WORTH_AN_EXCHANGE]
            tied.sort(key=lambda fit: self._rank(*(fit.values.keys() - values.keys())))
            ranked += tied
            left = [fit for fit in left if fit.loss > best + WORTH_AN_EXCHANGE]
        return ranked

    def _rank(self, name):
        return -self.effects[name].odds, self.names.index(name)

    def _at_its_own_noise(self, fit, values, line):
        """Return the values of a model with a further effect that stands at the noise which it leaves, else None."""
        (new,) = set(fit.values) - set(values)
        misfit, state = self.refits.misfit(line.residuals), self.residuals.state()
        found, _ = self.estimates.fitted(fit.values)
        residuals, without = self.refits.whitened([found, values])
        self.refits.set_scale(residuals)
        settled = Fit(found, self.refits.losses(residuals))
        if (
            self.refits.is_likelier(residuals, misfit, WORTH_A_JUMP)
            and self.judgement.p_values(found)[new] < self.alpha
            and self.judgement.improves(settled, self.refits.losses(without))
            and self.judgement.predicts(found, values)
        ):
            return found
        self.residuals.restore(state)
        self.refits.set_scale(line.residuals)
        return None

    def _exchanged(self, values, line):
        """Return a model with one named effect, or two, exchanged for another one, None if the present one is best.

        Then also the best of the others where it explains nearly as much, as a list. What was found first was found
        without what came later, and may stand for two causes where a later one left only one of them.
        """
        present = self.refits.losses(line.residuals)
        near: list[dict[str, float]] = []
        for n_dropped, models in self.proposals.exchanges(values, line):
            best = min(self.refits.fit(models, race=True), key=lambda fit: fit.loss)
            smaller_and_as_good = n_dropped == 2 and as_good(best.losses, present)
            if smaller_and_as_good or best.loss < present.sum() - WORTH_AN_EXCHANGE:
                return best.values, []
            kept = {name: value for name, value in values.items() if name in best.values}
            without = self.refits.losses(self.refits.whitened([kept])[0]).sum()
            if n_dropped == 1 and best.loss - present.sum() < NEARLY * (without - present.sum()):
                near = [best.values]
        return None, near

    def _apart(self, values, line):
        """Return the model with an effect on all elements taken apart into one for each, None if that is no better.

        Where some elements of a family differ and others do not, what is common to all is found first, and no single
        element can then be added to it.
        """
        loss = self.refits.losses(line.residuals).sum()
        for name in values:
            effect = self.effects[name]
            elements = [
                other.name
                for other in self.effects.values()
                if other.family == effect.family and other.target != "all" and other.name not in values
            ]
            if effect.target != "all" or not 2 <= len(elements) <= MOST_ELEMENTS:
                continue
            rest = {other: value for other, value in values.items() if other != name}
            fit = self.refits.fit([{**rest, **dict.fromkeys(elements, values[name])}])[0]
            if fit.loss > APART_LOSS * loss:
                continue
            while True:
                p_values = self.judgement.p_values(fit.values)
                kept = {other: value for other, value in fit.values.items() if p_values[other] < self.alpha}
                if len(kept) == len(fit.values) or not kept:
                    break
                fit = self.refits.fit([kept])[0]
            if kept and len(kept) <= self.max_effects and fit.loss < APART_LOSS * loss:
                return fit.values
        return None

    def _elsewhere(self, values, loss, names):
        """Return the model with one of the effects at quite another value, all refitted, None if none is far better.

        A descent ends in the nearest optimum, and where an effect bends, as the time step does, another one may be
        deeper.
        """
        fits = self.refits.fit(self.proposals.elsewhere(values, names))
        best = min(fits, key=lambda fit: fit.loss, default=None)
        return best.values if best is not None and best.loss < loss - WORTH_A_JUMP else None

    # -- decisions -------------------------------------------------------------------------------------------------

    def _prune(self, values, line, spread=None):
        """Drop effects that mislead, or are no longer significant beside the others.

        `spread` is by how much their values vary from one settling to the next.
        """
        p_values: dict[str, float] = {}
        by_fall: set[str] = set()
        while values:
            self.refits.set_scale(line.residuals)
            losses = self.refits.losses(line.residuals)
            p_values |= {
                name: p_value
                for name, p_value in self.judgement.p_values(values, spread).items()
                if name not in by_fall
            }
            worst = max(p_values, key=lambda name: p_values[name])
            significant = p_values[worst] < self.alpha
            if significant:
                worst = self.judgement.misleading(values)
                if worst is None:
                    break
                self.refused = Refused(worst, values[worst], float(losses.sum()))
            kept = {name: value for name, value in values.items() if name != worst}
            without = self.refits.fit([kept])[0]
            p_value = family_p_value(fall_p_value(without.losses, losses), len(self.names))
            if not significant and p_value < self.alpha:
                p_values[worst] = p_value
                by_fall.add(worst)
                continue
            if kept:
                values, line = self._simplified(*self.estimates.polished(without.values))
            else:
                values, line = {}, self.estimates.linearised({})
            p_values, by_fall, spread = {}, set(), None
        return Pruned(values, line, p_values, by_fall)

    def _result(self, pruned, spread):
        values, line = pruned.values, pruned.line
        gram = grams(line.residuals, line.derivatives, self.estimates.clusters(len(line.names)))
        if not values:
            return Selected({}, {}, {}, {}, line, gram, self.refused)
        names, covariance, freedom = self.estimates.covariance(values)
        errors = np.hypot(np.sqrt(np.diag(covariance)), [spread[name] for name in names])
        distances = [abs(values[name] - self.effects[name].neutral) for name in names]
        telling = dict(zip(names, distances / errors))
        by_value = self.judgement.in_family(
            values, {name: 2 * stats.t.sf(telling[name], freedom[k]) for k, name in enumerate(names)}
        )
        p_values = {name: min(by_value[name], pruned.p_values[name]) for name in names}
        intervals = {}
        for k, name in enumerate(names):
            reach = stats.t.ppf(0.975, freedom[k]) * errors[k]
            low, high = self.effects[name].bounds
            intervals[name] = (max(values[name] - reach, low), min(values[name] + reach, high))
            # The error of an effect at a kink may be another one from one secant to the next.
            if name in pruned.by_fall or by_value[name] >= self.alpha:
                intervals[name] = self.estimates.profile_interval(name, values, line)
        order = sorted(names, key=lambda name: telling[name], reverse=True)
        aliases = find_aliases(
            self.estimates, self.proposals, {name: values[name] for name in order}, line, self.progress
        )
        for cause, rival in self._better(values):
            aliases[cause] = tuple(dict.fromkeys((*aliases[cause], rival)))
        refused = None if self.refused is None or self.refused.name in values else self.refused
        return Selected(
            {name: values[name] for name in order}, p_values, intervals, aliases, line, gram, refused
        )

    def _better(self, values):
        """Return (cause, effect) where the effect explained the log better in the cause's place, but did not stand.

        Such as friction that stops whatever moves: it has no size that is certain.
        """
        better = self.better.get(frozenset(values), frozenset(values))
        gone, new = values.keys() - better, better - values.keys()
        return [(*gone, *new)] if len(gone) == len(new) == 1 else []
