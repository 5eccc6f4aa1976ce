"""The map of two samples in eighty digits, and samples of a given condition."""

import mpmath as mp
import numpy as np


def exact_map(X, y):
    """Return the optimal map of the samples' covariances, computed from their exact values."""
    with mp.workdps(80):
        source, target = _covariance(X), _covariance(y)
        root = _power(target, mp.mpf(1) / 2)
        coef = root * _power(root * source * root, -mp.mpf(1) / 2) * root
        return np.array(coef.tolist(), dtype=float)


def rotated(rng, n_rows, n_features, condition):
    """Return rows whose principal axes are turned at random, of about this condition of the covariance."""
    turn = np.linalg.qr(rng.normal(size=(n_features, n_features)))[0]
    return rng.normal(size=(n_rows, n_features)) * np.logspace(0, -np.log10(condition) / 2, n_features) @ turn


def graded(rng, n_rows, n_features, condition):
    """Return correlated rows whose columns are in units that differ by the root of this condition."""
    units = rng.permutation(np.logspace(0, -np.log10(condition) / 2, n_features))
    return rng.normal(size=(n_rows, n_features)) @ rng.normal(size=(n_features, n_features)) * units + units


def relative_error(found, true):
    """Return the error in the Frobenius norm."""
    return np.linalg.norm(found - true) / np.linalg.norm(true)


def _covariance(rows):
    rows = mp.matrix(np.asarray(rows, dtype=float).tolist())
    n_rows, n_features = rows.rows, rows.cols
    for j in range(n_features):
        mean = mp.fsum(rows[i, j] for i in range(n_rows)) / n_rows
        for i in range(n_rows):
            rows[i, j] -= mean
    return rows.T * rows / n_rows


def _power(matrix, exponent):
    values, vectors = mp.eigsy(matrix)
    return vectors * mp.diag([mp.power(abs(value), exponent) for value in values]) * vectors.T
