"""Which other models are worth a refit: one effect more, one in the place of another, a value far from the present one.

All of it is to first order, or from few rows; what is proposed is refitted and judged in `selection.py`.
"""

from itertools import combinations

import numpy as np

from skat.diagnosis.evidence import family_p_value, solve_scaled

SHORTLIST = 8
# Exchanges refitted for each set of effects that stays.
EXCHANGES = 3
# Family-wise p-value of the most telling effect, and each one's own, that make refits worth their time.
WORTH_A_LOOK = 0.5
WORTH_A_STEP = 0.05
CONTENDERS = 6
SHARES_OF_STEP = (1.0, 0.3, 0.1)
# Values tried over an effect's range when the model is far off, in units of the way to each bound.
GRID = (0.02, 0.1, 0.4)
FACTORS = (0.33, 0.5, 0.7, 0.85, 1.2, 1.5, 2.0, 3.0)
# A limit may be so far away that it wakes up only there.
FAR_FACTORS = (0.03, 0.06, 0.1, 0.2, 5.0, 10.0)
LONGEST_GRID = 5
# Fall of the log error, summed over channels, that makes a value far off worth a refit.
WORTH_A_REFIT = 0.3
ROWS_OF_GRID = 72
# A sixth of the rows says which values deserve all of them: one of so many.
ROUGH_SHARE = 6
GRID_SHARE = 8
# Of the losses of many models, so many models are simulated at a time.
AT_A_TIME = 32


class Proposals:
    """Models worth a refit.

    Parameters
    ----------
    estimates : Estimates
    """

    def __init__(self, estimates):
        self.residuals, self.refits, self.effects = estimates.residuals, estimates.refits, estimates.effects
        self.n_screened = len(estimates.names)
        self.time_step = self.residuals.simulator.time_step
        # Effects that change nothing anywhere in their range.
        self.dead: set[str] = set()

    # -- one effect more -------------------------------------------------------------------------------------------

    def further(self, values, first, *, far_off, some_far_off):
        """Yield lists of models with a further effect, to be refitted in turn until one of a list stands.

        Parameters
        ----------
        values : dict of str to float
            The present model.
        first : Screen
            Of all effects, at the present model.
        far_off : bool
            Whether derivatives say little of what the present model misses.
        some_far_off : bool
            Whether they do in some rows, as at impacts; the most telling effects are tried over their whole range then.
        """
        steps, grid = [], []
        if far_off or family_p_value(first.p_values.min(), self.n_screened) < WORTH_A_LOOK:
            steps = self._steps(values, first, 1.0 if far_off else WORTH_A_STEP)
        if steps and not far_off:
            yield self._contenders(values, steps)
            steps = []
        if some_far_off and not far_off:
            telling = [k for k in np.argsort(first.p_values) if first.p_values[k] < WORTH_A_STEP][:SHORTLIST]
            for name in (first.names[k] for k in telling):
                grid += [{name: point} for point in _points(self.effects[name]) if name not in values]
        if far_off or not values:
            grid += self._grid(values, [first.names[k] for k in np.flatnonzero(first.p_values < 1)])
            grid += self.asleep(values, [first.names[k] for k in np.flatnonzero(first.flat)])
        if steps or grid:
            yield self._contenders(values, steps + grid)

    def _steps(self, values, first, least_p_value):
        """Return linear steps {name: value} of the effects worth a refit, whole and shortened, and a delay's places.

        Where an effect bends, as at impacts, the whole of a linear step may overshoot.
        """
        worth = (first.gains > 0) & (first.p_values < least_p_value)
        order = [k for k in np.argsort(first.gains)[::-1] if worth[k] and first.names[k] not in values]
        telling = [k for k in np.argsort(first.p_values) if worth[k] and first.names[k] not in values]
        steps = [
            {first.names[k]: float(self.effects[first.names[k]].neutral + share * first.moves[k])}
            for k in dict.fromkeys(order[:SHORTLIST] + telling[:3])
            for share in SHARES_OF_STEP
        ]
        late = [first.names[k] for k in range(len(first.names)) if first.p_values[k] < least_p_value]
        return steps + [
            {name: place} for name in late if name not in values for place in self._places(self.effects[name])
        ]

    def _places(self, effect):
        """Return the values of a delay at which its derivative jumps, all of them starts: whole time steps, and rows.

        A descent does not leave the time step that it begins in: the loss has a minimum of its own in each, where
        commands change from row to row.
        """
        if effect.family != "delay" or not self.time_step:
            return []
        n_places = int(effect.bounds[1] / self.time_step + 1e-9)
        places = (place * self.time_step for place in range(1, n_places + 1))
        return [min(place, effect.bounds[1]) for place in places]

    def _grid(self, values, names):
        """Return the best starting values over the whole range of every effect: far off, a derivative misleads."""
        candidates = []
        for name in names:
            if name not in values:
                candidates += [{name: point} for point in _points(self.effects[name])]
        if not candidates:
            return []
        rough = self.residuals.error_sizes(
            [{**values, **one} for one in candidates], ROWS_OF_GRID // ROUGH_SHARE
        )
        candidates = [candidates[k] for k in np.argsort(rough)[: -(-len(candidates) // GRID_SHARE)]]
        sizes = self.residuals.error_sizes([values, *({**values, **one} for one in candidates)], ROWS_OF_GRID)
        losses = sizes[1:]
        best: dict[str, tuple] = {}
        for candidate, loss in zip(candidates, losses):
            (name,) = candidate
            if name not in best or loss < best[name][0]:
                best[name] = (loss, candidate)
        ranked = sorted(best.values(), key=lambda pair: pair[0])
        return [candidate for size, candidate in ranked[:LONGEST_GRID] if size < sizes[0] - WORTH_A_REFIT]

    def asleep(self, values, names):
        """Return the best starting value of each effect that has no derivative at a model but acts elsewhere.

        A limit that is not reached is one. What acts nowhere, such as the friction of what never touches anything, is
        asked once.
        """
        best = []
        for name in names:
            if name in values or name in self.dead:
                continue
            models = [{**values, name: point} for point in _far_points(self.effects[name])]
            moved = self.residuals.moved(values, models, ROWS_OF_GRID) if models else []
            models = [model for model, moves in zip(models, moved) if moves]
            if models:
                best.append({name: models[int(np.argmin(self._losses(models)))][name]})
            else:
                self.dead.add(name)
        return best

    def _contenders(self, values, starts):
        """Return the best model of each effect that is new, and of those the best few."""
        models = [{**values, **start} for start in starts]
        losses = self._losses(models)
        best: dict[str, dict] = {}
        for index in np.argsort(losses):
            (new,) = starts[index]
            best.setdefault(new, models[index])
        return list(best.values())[:CONTENDERS]

    # -- another effect, another value -----------------------------------------------------------------------------

    def exchanges(self, values, line):
        """Yield (number of effects dropped, models with another effect in their place), two dropped before one.

        What a model without them misses is simulated, since far from neutral a derivative says little of it; what
        another effect explains of that is a matter of the Grams, or of its range where a derivative says nothing.
        """
        names = list(line.names)
        weighted = line.derivatives * self.refits.weights(line.residuals)[:, None, None]
        information = np.einsum("ndk,ndl->kl", weighted, line.derivatives, optimize=True)
        fresh = [k for k in range(len(names)) if names[k] not in values and information[k, k] > 0]
        flat = [name for k, name in enumerate(names) if name not in values and information[k, k] == 0]
        for n_dropped in (2, 1) if len(values) > 1 else (1,):
            subsets = [
                {name: values[name] for name in kept}
                for kept in combinations(values, len(values) - n_dropped)
            ]
            models = []
            for kept, missed in zip(subsets, self.refits.whitened(subsets)):
                score = np.einsum("ndk,nd->k", weighted, missed)
                inside = [names.index(name) for name in kept]
                explained = []
                for k in fresh:
                    chosen = [*inside, k]
                    moves = solve_scaled(information[np.ix_(chosen, chosen)], score[chosen][:, None])[:, 0]
                    explained.append((score[chosen] @ moves, self.effects[names[k]], moves[-1]))
                explained.sort(key=lambda one: one[0], reverse=True)
                models += [
                    {**kept, effect.name: float(np.clip(effect.neutral + move, *effect.bounds))}
                    for _, effect, move in explained[:EXCHANGES]
                ]
                models += [{**kept, **start} for start in self.asleep(kept, flat)]
            if models:
                yield n_dropped, models

    def n_values(self, name):
        """Return how many values of an effect are tried where it is asleep."""
        return len(_far_points(self.effects[name]))

    def elsewhere(self, values, names):
        """Return for each of the effects the best model that has it at quite another value."""
        best = []
        for name in names:
            points = _points(self.effects[name]) + self._places(self.effects[name])
            models = [{**values, name: point} for point in points if point != values.get(name)]
            if models:
                best.append(models[int(np.argmin(self._losses(models)))])
        return best

    def _losses(self, models):
        return [
            self.refits.losses(one).sum()
            for first in range(0, len(models), AT_A_TIME)
            for one in self.refits.whitened(models[first : first + AT_A_TIME])
        ]


def _points(effect, factors=FACTORS):
    """Return values over the whole range of an effect."""
    if effect.is_factor:
        points = [*factors, 0.0, -1.0] if effect.bounds[0] < 0 else list(factors)
    else:
        points = [effect.neutral + share * (end - effect.neutral) for share in GRID for end in effect.bounds]
    low, high = effect.bounds
    return [point for point in points if low <= point <= high and point != effect.neutral]


def _far_points(effect):
    return _points(effect, FACTORS + FAR_FACTORS)
