"""Carry simulated transitions onto those of a changed world by skat and by the tools that people use for it.

Rows are (state, action, next state) of one robot in two worlds of the paper's Table I, replayed from the same states
and actions, so that each carried row has a true partner. Every method is fitted on the same rows and tested on others.
The error is the mean distance of a carried row and its partner, each column of the next state in standard deviations of
the target. Printed is its ratio to the error of doing nothing, medians over the worlds, and seconds of CPU of one fit
and transform. The peers are given columns scaled by both domains together: as they come, they fail or do worse;
linear maps get a ridge of 1e-6, as their default of 1e-8 fails in most of these worlds.
"pairs" says that a method is told which rows belong together. Regression carries no distribution, and the first has
no simulation.

    python benchmarks/peers.py                   # a few minutes
    python benchmarks/peers.py --small           # seconds
"""

import argparse
import time
import warnings

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

import skat
from skat.experiments import replay_transitions

WORLDS = ("light", "heavy", "long", "short", "some_inverted", "inverted", "some_off")


def by_skat(estimator):
    """Return a method that fits an estimator of skat."""
    return lambda X, y, new, _: estimator.fit(X, y).transform(new)


def by_pot(name, **options):
    """Return a method that fits one of POT's transports."""

    def carry(X, y, new, _):
        import ot

        return getattr(ot.da, name)(**options).fit(Xs=X, Xt=y).transform(Xs=new)

    return scaled(carry)


def scaled(method):
    """Return a method in columns scaled by those of both domains together, as skada's examples have it."""

    def carry(X, y, new, context):
        scaler = StandardScaler().fit(np.vstack([X, y]))
        carried = method(scaler.transform(X), scaler.transform(y), scaler.transform(new), context)
        return scaler.inverse_transform(carried)

    return carry


def by_skada(name, **options):
    """Return a method that fits one of skada's adapters on stacked rows."""

    def carry(X, y, new, _):
        import skada

        model = getattr(skada, name)(**options)
        domain = np.repeat([1, -2], [len(X), len(y)])
        model.fit(np.vstack([X, y]), sample_domain=domain)
        return model.transform(new, sample_domain=np.ones(len(new), int), allow_source=True)

    return scaled(carry)


def by_regression(of_what):
    """Return a ridge regression of what the target has: on the inputs alone, or on the simulated row as well."""

    def carry(X, y, new, context):
        inputs, given = (X[:, :context], new[:, :context]) if of_what == "inputs" else (X, new)
        model = make_pipeline(StandardScaler(), RidgeCV(np.logspace(-6, 3, 10), alpha_per_target=True))
        return np.hstack([new[:, :context], model.fit(inputs, y[:, context:]).predict(given)])

    return carry


def methods(context):
    """Return the methods by name, and whether they are told the pairs."""
    return {
        "skat AffineTransport": (by_skat(skat.AffineTransport()), False),
        'skat AffineTransport("target")': (by_skat(skat.AffineTransport(metric_scale="target")), False),
        "skat CORAL": (by_skat(skat.CORAL()), False),
        "skat ConditionalAffineTransport": (by_skat(skat.ConditionalAffineTransport(context=context)), False),
        "skat ProcrustesAffineTransport": (by_skat(skat.ProcrustesAffineTransport()), True),
        "POT LinearTransport": (by_pot("LinearTransport", reg=1e-6), False),
        "POT EMDTransport": (by_pot("EMDTransport"), False),
        "POT SinkhornTransport": (by_pot("SinkhornTransport", reg_e=0.1, norm="median", max_iter=300), False),
        "skada LinearOTMappingAdapter": (by_skada("LinearOTMappingAdapter", reg=1e-6), False),
        "skada CORALAdapter": (by_skada("CORALAdapter"), False),
        "sklearn ridge, without simulation": (by_regression("inputs"), True),
        "sklearn ridge of the simulated row": (by_regression("rows"), True),
    }


def compared(robot, n_rows, worlds):
    """Return ratios and seconds by method, one of each per world, and what failed."""
    replay = replay_transitions(robot, n_transitions=2 * n_rows, conditions=("normal", *worlds))
    order = np.random.default_rng(0).permutation(2 * n_rows)
    fit, test = order[:n_rows], order[n_rows:]
    source, context = replay.rows("normal"), replay.context
    ratios, seconds, failed = {}, {}, {}
    for world in worlds:
        target = replay.rows(world)
        scale = target[fit, context:].std(axis=0)

        def error(rows, target=target, scale=scale):
            apart = (rows - target[test])[:, context:] / np.where(scale > 0, scale, 1)
            return np.linalg.norm(apart, axis=1).mean()

        before = error(source[test])
        for name, (carry, _) in methods(context).items():
            began = time.process_time()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of peers; an error below shows what matters
                    carried = np.asarray(carry(source[fit], target[fit], source[test], context))
            except (ImportError, ValueError, np.linalg.LinAlgError) as problem:
                failed.setdefault(name, []).append(
                    f"{type(problem).__name__}: {str(problem).splitlines()[0][:60]}"
                )
                continue
            seconds.setdefault(name, []).append(time.process_time() - began)
            ratios.setdefault(name, []).append(error(carried) / before)
    return ratios, seconds, failed


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--small", action="store_true", help="one robot, two worlds, few rows")
    small = parser.parse_args().small
    print(versions())
    for robot in ("hopper",) if small else ("hopper", "halfcheetah"):
        n_rows, worlds = (200, WORLDS[:2]) if small else (500, WORLDS)
        ratios, seconds, failed = compared(robot, n_rows, worlds)
        print(f"\n{robot}: {n_rows} rows to fit, {n_rows} others to test, {len(worlds)} worlds")
        print(f"{'method':36}{'pairs':>6}{'error after / before':>22}{'worst world':>13}{'CPU s':>8}")
        for name, (_, paired) in methods(1).items():
            told = "yes" if paired else "no"
            if name in ratios:
                print(
                    f"{name:36}{told:>6}{np.median(ratios[name]):22.3f}{np.max(ratios[name]):13.3f}"
                    f"{np.median(seconds[name]):8.2f}"
                )
            if name in failed:
                print(f"{'':36}{told:>6}  fails in {len(failed[name])} worlds: {failed[name][0]}")


def versions():
    """Return who took part."""
    from importlib.metadata import PackageNotFoundError, version

    found = []
    for package in ("numpy", "scikit-learn", "POT", "skada"):
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"{package} is not installed")
    return ", ".join(found)


if __name__ == "__main__":
    main()
