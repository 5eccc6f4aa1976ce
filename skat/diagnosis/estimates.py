"""Values of the named effects: fitted, how exactly they are known, and the linearisation there.

At contacts a log's loss is jagged on the scale of an estimate's uncertainty. Descents get stuck in jags, and
derivatives over steps that are small against the uncertainty take jags for precision, or for evidence. Values are
therefore fitted and judged by secants that are as wide as they are uncertain.
"""

import numpy as np
from scipy import stats

from skat.diagnosis.evidence import as_good, grams, lone_statistics, wald
from skat.diagnosis.refits import Refits

POLISH_STEPS = 5
# Standard errors within which derivatives by the state are kept from one step to the next.
CLOSE = 2.0
# The named effects are settled and fitted so many times at the end, once they are within so many standard errors of
# their place, and so many times in all; not at all where they stay within this share of their standard errors.
SETTLINGS = 3
MOST_SETTLINGS = 6
NEAR = 1.5
SETTLED = 0.2
LONGEST_STEP = 10.0
# Where a fit has not settled it starts again from these shares of its distance from neutral. Another value is taken if
# it is likelier by so much of twice the log likelihood, which changes by less from one settling to the next.
SHARES_FROM_AFAR = (0.5, 1.5)
ROUNDS_FROM_AFAR = 2
WORTH_ANOTHER_PLACE = 300.0
# Secants reach so many standard errors to both sides, or over this share of the effect's range.
SECANT_IN_ERRORS = 5.0
WIDEST_SECANT = 0.1
# A derivative may be that of a jag if its step is smaller than such a secant by more than this factor, or if it comes
# from fewer than about so many rows; secants that reach so many steps are tried in its place, the wider ones where the
# narrower tell more than the derivative.
JAGGED = 3.0
FEWEST_ROWS = 10
SECANTS_IN_STEPS = (10.0, 30.0)
# Level of either end of an interval by profile; the end is narrowed to a fourth so many times at most, or until it is
# known to this share of its distance.
INTERVAL_LEVEL = 0.025
PROFILE_STEPS = 8
PROFILE_ACCURACY = 0.1
# Numbers in the information of all pieces of time together.
LARGEST_GRAM = 50_000_000
FEWEST_BLOCKS_TO_WIDEN = 10


class Estimates:
    """Estimates of named effects at the optimum of their own smoothed states and noise.

    Parameters
    ----------
    residuals : Residuals
    names : sequence of str
        Effects that linearisations are by.

    Attributes
    ----------
    refits : Refits
    """

    def __init__(self, residuals, names):
        self.residuals, self.names = residuals, list(names)
        self.effects, self.blocks = residuals.effects, residuals.blocks
        self.refits = Refits(residuals)
        # Standard error of each effect when it was last fitted.
        self.errors: dict[str, float] = {}
        # Noise and smoothed states of the model without effects.
        self.neutral_state: dict = {}

    def linearised(self, values, *, settled=False):
        """Return the linearisation by all effects at a model that noise and smoothed states are adapted to."""
        if not settled:
            self.residuals.settle(values)
        line = self.residuals.linearise(values, self.names)
        if not values:
            self.neutral_state = self.residuals.state()
        line = self._without_jags(line)
        self.refits.set_scale(line.residuals)
        return line

    def _without_jags(self, line):
        """Return the linearisation with secants wherever a derivative may be that of a jag, and they tell more.

        So it may be where few rows make up most of what an effect shows, or where its step is small against its error.
        """
        clusters = self.clusters(len(line.names))
        told, errors, freedom = lone_statistics(grams(line.residuals, line.derivatives, clusters))
        jagged = {
            name: k
            for k, name in enumerate(line.names)
            if freedom[k] < FEWEST_ROWS
            or self._secant_width(name, errors[k]) > JAGGED * self.residuals.slopes.steps[name]
        }
        for factor in SECANTS_IN_STEPS:
            if not jagged:
                break
            widths = {
                name: self._at_most_widest(name, factor * self.residuals.slopes.steps[name])
                for name in jagged
            }
            slopes = self.residuals.secants(line.values, widths)
            tells = lone_statistics(grams(line.residuals, self.residuals.whiten(slopes), clusters))[0]
            better = {name: i for i, (name, k) in enumerate(jagged.items()) if abs(tells[i]) > abs(told[k])}
            for name, i in better.items():
                told[jagged[name]] = tells[i]
            line = self.residuals.with_slopes(line, better, slopes[..., list(better.values())])
            jagged = {name: jagged[name] for name in better}
        return line

    def polished(self, values):
        """Return a model at the optimum of its own smoothed states and noise, and its linearisation."""
        values, settled = self.fitted(values)
        if not settled:
            values, settled = self._from_afar(values)
        return values, self.linearised(values, settled=settled)

    def _from_afar(self, values):
        """Return the likeliest of a model's fits that start nearer to neutral and further from it, or the model itself.

        At contacts, where fits do not settle, a wrong value may keep itself up: states are smoothed to it, and what it
        misses passes for noise. So these start from the noise and the states of the model without effects.
        """
        best, settled, state = values, False, self.residuals.state()
        misfit = self.refits.misfit(self.refits.whitened([values])[0])
        for _ in range(ROUNDS_FROM_AFAR):
            origin = best
            for share in SHARES_FROM_AFAR:
                self.residuals.restore(self.neutral_state)
                found, is_settled = self.fitted(self._at_share(origin, share))
                residuals = self.refits.whitened([found])[0]
                if self.refits.is_likelier(residuals, misfit, WORTH_ANOTHER_PLACE):
                    best, settled = found, is_settled
                    misfit, state = self.refits.misfit(residuals), self.residuals.state()
            if settled or best is origin:
                break
        self.residuals.restore(state)
        return best, settled

    def _at_share(self, values, share):
        """Return values at a share of their distance from neutral, within their bounds."""
        scaled = {}
        for name, value in values.items():
            neutral, bounds = self.effects[name].neutral, self.effects[name].bounds
            scaled[name] = float(np.clip(neutral + share * (value - neutral), *bounds))
        return scaled

    def fitted(self, values):
        """Return a model at the optimum of its own smoothed states and noise, and whether these are settled there."""
        nearly_there = False
        for _ in range(POLISH_STEPS):
            self.residuals.settle(values, roughly=nearly_there)
            before = values
            self.refits.set_scale(self.residuals.whitened([values])[0])
            values = self.refits.fit([values])[0].values
            errors = np.sqrt(np.diag(self.covariance(values)[1]))
            moves = [abs(values[name] - before[name]) / error for name, error in zip(values, errors)]
            if max(moves) < SETTLED:
                break
            nearly_there = max(moves) < CLOSE
        return values, max(moves) < SETTLED and not nearly_there

    def averaged(self, values, line):
        """Return the mean of values settled and fitted again and again, its linearisation, and their spread.

        At contacts smoothed states and derivatives jump from one settling to the next, and with them the optimum:
        an uncertainty that no statistic at fixed states sees. Where the simulation is smooth there is none. The loss
        has steps there, too, in which a descent gets stuck; Gauss-Newton steps by secants pass over them.
        """
        if not values:
            return values, line, {}
        first, settled = values, False
        drawn: list[list[float]] = []
        for _ in range(MOST_SETTLINGS):
            moved, moves = self._newton(values)
            largest = np.max(np.abs(moves))
            settled = bool(largest < SETTLED and not drawn)
            if settled:
                break
            if drawn or largest < NEAR:
                drawn.append(list(moved.values()))
            if len(drawn) == SETTLINGS:
                break
            last_step = np.abs([moved[name] - value for name, value in values.items()])
            values = moved
            self.residuals.settle(values)
            self.refits.set_scale(self.residuals.whitened([values])[0])
        names = list(values)
        if settled and values is first:
            return values, line, dict.fromkeys(names, 0.0)
        if settled:
            spread = np.zeros(len(names))
        elif len(drawn) == SETTLINGS:
            spread = np.std(drawn, axis=0, ddof=1)
            values = dict(zip(names, map(float, np.mean(drawn, axis=0))))
        else:  # Still on the way: the last step is as far as the truth may be.
            spread = last_step
        line = self.residuals.shifted(line, values)
        self.refits.set_scale(line.residuals)
        return values, line, dict(zip(names, map(float, spread)))

    def _newton(self, values):
        """Return values after a Gauss-Newton step by secants within the bounds, and its length in standard errors."""
        gram = self._secant_grams(values)[2]
        stepped, _ = self.refits.step(values, gram.information.sum(axis=0), gram.scores.sum(axis=0), 0.0)
        moves = np.subtract(list(stepped.values()), list(values.values())) / np.sqrt(np.diag(wald(gram)[0]))
        share = min(1.0, LONGEST_STEP / max(np.max(np.abs(moves)), 1e-300))
        moved = {name: value + share * (stepped[name] - value) for name, value in values.items()}
        return moved, share * moves

    def covariance(self, values):
        """Return (names, covariance, degrees of freedom) of fitted values.

        What neighbours in time have in common widens the covariance where enough blocks tell; the degrees of freedom
        are then those of the blocks.
        """
        names = list(values)
        residuals, derivatives, gram = self._secant_grams(values)
        covariance, freedom = wald(gram)
        by_block, block_freedom = wald(
            grams(residuals, derivatives, self.blocks, self.refits.weights(residuals))
        )
        variances = np.diag(covariance)
        enough = np.isfinite(variances) & (variances > 0) & (block_freedom > FEWEST_BLOCKS_TO_WIDEN)
        ratio = np.where(enough, np.diag(by_block), 1.0) / np.where(enough, variances, 1.0)
        widen = np.sqrt(np.maximum(np.nan_to_num(ratio, nan=1.0), 1.0))
        return names, covariance * np.outer(widen, widen), np.where(widen > 1, block_freedom, freedom)

    def _secant_grams(self, values):
        """Return residuals, their slopes by the values (n_rows, n_channels, n_values), and the Grams of both.

        The slopes are those of secants as wide as the values are uncertain: at contacts a derivative tells of steps
        that are small against that, and promises a precision that is not there.
        """
        names = list(values)
        residuals = self.residuals.whitened([values])[0]
        weights, clusters = self.refits.weights(residuals), self.clusters(len(names))
        if not all(np.isfinite(self.errors.get(name, np.inf)) for name in names):
            slopes = self.residuals.derivatives(values, names)
            self._remember_errors(names, grams(residuals, slopes, clusters, weights))
        widths = {name: self._secant_width(name, self.errors[name]) for name in names}
        slopes = self.residuals.whiten(self.residuals.secants(values, widths))
        gram = grams(residuals, slopes, clusters, weights)
        self._remember_errors(names, gram)
        return residuals, slopes, gram

    def _secant_width(self, name, error):
        return self._at_most_widest(name, SECANT_IN_ERRORS * error) if np.isfinite(error) else 0.0

    def _at_most_widest(self, name, width):
        return min(width, WIDEST_SECANT * np.ptp(self.effects[name].bounds))

    def _remember_errors(self, names, gram):
        errors = np.sqrt(np.diag(wald(gram)[0]))
        self.errors.update(zip(names, np.where(np.isfinite(errors) & (errors > 0), errors, np.inf)))

    def clusters(self, n_effects):
        """Return the piece of evidence of each row: a row where memory allows, whitened rows being uncorrelated.

        Rows without time order that were given in groups may have something in common: there it is a group.
        """
        count = len(self.blocks)
        rows = np.arange(count) if self.residuals.log.consecutive else self.blocks
        return rows // -(-count * n_effects**2 // LARGEST_GRAM)

    def p_values(self, values, spread=None):
        """Return the p-value of each fitted value by itself, given by how much it varies beside its standard error."""
        names, covariance, freedom = self.covariance(values)
        p_values = {}
        for k, name in enumerate(names):
            distance = abs(values[name] - self.effects[name].neutral)
            error = np.hypot(np.sqrt(covariance[k, k]), (spread or {}).get(name, 0.0))
            p_values[name] = float(2 * stats.t.sf(distance / max(error, 1e-150), freedom[k]))
        return p_values

    def profile_interval(self, name, values, line):
        """Return the values of an effect, the others refitted, that fit the log not significantly worse.

        Where a derivative says little, because the simulation has kinks or the effect is at a bound.
        """
        neutral, (low, high) = self.effects[name].neutral, self.effects[name].bounds
        best, reference = values[name], self.refits.losses(line.residuals)
        width = SECANT_IN_ERRORS * self.errors.get(name, np.inf)

        def first_bad(points):
            fits = self.refits.fit([values | {name: float(point)} for point in points], hold=name)
            good = [as_good(fit.losses, reference, INTERVAL_LEVEL) for fit in fits]
            return good.index(False) if False in good else len(good)

        ends = []
        for end in (low, high):
            limit = neutral if (neutral - best) * (end - best) > 0 else end
            inside, outside = best, best + float(np.clip(limit - best, -width, width))
            while outside != limit and first_bad([outside]):
                inside, outside = (
                    outside,
                    best + float(np.clip(4 * (outside - best), *sorted((0.0, limit - best)))),
                )
            for _ in range(PROFILE_STEPS):
                if abs(outside - inside) <= PROFILE_ACCURACY * abs(outside - best):
                    break
                points = inside + (outside - inside) * np.arange(1, 5) / 4
                bad = first_bad(points)
                if bad == len(points):
                    break
                inside, outside = points[bad - 1] if bad else inside, points[bad]
            ends.append(float(outside))
        return ends[0], ends[1]
