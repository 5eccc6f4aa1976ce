"""Which rows of a stacked array are source rows and which are target rows, however their domains are labelled."""

from typing import Any

import numpy as np

from skat.gaussian.backends import on_host

__all__ = ["are_among", "domain_signs", "some_of"]

WORDS = {"source": 1, "sim": 1, "simulated": 1, "simulation": 1, "target": -1, "real": -1, "measured": -1}


def domain_signs(sample_domain: Any, n_rows: int | None = None, source_domain: Any = None) -> Any:
    """Return the domain of each row as a number: positive for source rows, negative for target rows.

    Parameters
    ----------
    sample_domain : array-like of shape (n_rows,)
        Numbers, positive for source and negative for target rows; the words "sim" and "real" (or "source",
        "simulated", "simulation" and "target", "measured"); or labels of any kind, with `source_domain`.
    n_rows : int, default=None
        What their number has to be.
    source_domain : label or list of labels, default=None
        The labels of source rows; all others are of target rows.

    Returns
    -------
    ndarray of shape (n_rows,)
        The numbers as given, or 1 and -1.

    Raises
    ------
    ValueError
        If there is not one label for each row, or labels say nothing without `source_domain`, or are missing.

    Examples
    --------
    >>> domain_signs(["sim", "real", "sim"])
    array([ 1, -1,  1])
    >>> domain_signs([0, 1, 1], source_domain=0)
    array([ 1, -1, -1])
    """
    domain = on_host(sample_domain)
    if domain.ndim != 1:
        raise ValueError(
            f"sample_domain must be a 1-D array of one label per row; it has shape {domain.shape}."
        )
    if n_rows is not None and len(domain) != n_rows:
        raise ValueError(f"sample_domain must have one value per row; it has {len(domain)}, X {n_rows} rows.")
    is_number = np.issubdtype(domain.dtype, np.number)
    if source_domain is not None:
        return np.where(are_among(domain, source_domain), 1, -1)
    if not is_number:
        unknown = [label for label in dict.fromkeys(domain.tolist()) if label not in WORDS]
        if unknown:
            raise ValueError(
                "sample_domain must be a 1-D array of numbers, positive for source and negative for target rows, "
                f'or of "sim" and "real"; it holds {some_of(unknown)}. For other labels say which is the source, '
                f"by source_domain={unknown[0]!r} or another of them."
            )
        return np.array([WORDS[label] for label in domain.tolist()], dtype=int)
    undecided = np.count_nonzero(~((domain > 0) | (domain < 0)))
    if undecided:
        raise ValueError(
            f"sample_domain must be positive for source and negative for target rows; {undecided} of "
            f"{len(domain)} values are zero or NaN. For labels such as 0 and 1 say which is the source, "
            "by source_domain=0 or source_domain=1."
        )
    return domain


def are_among(labels: Any, wanted: Any) -> Any:
    """Return which labels are the one wanted, or one of several.

    Parameters
    ----------
    labels : ndarray of shape (n_rows,)
    wanted : label or list of labels

    Returns
    -------
    ndarray of bool of shape (n_rows,)

    Raises
    ------
    ValueError
        If a label is missing.
    """
    missing = np.array([label is None or label != label for label in labels.tolist()], dtype=bool)
    if missing.any():
        raise ValueError(f"sample_domain has no label for {missing.sum()} of {len(labels)} rows. Label all.")
    wanted = np.atleast_1d(np.asarray(wanted, dtype=object))
    # Numbers in a list that holds words, too, become words in an array of NumPy.
    if labels.dtype.kind == "U":
        wanted = wanted.astype(str)
    return np.isin(labels.astype(object), wanted)


def some_of(labels: Any) -> Any:
    """Return a text that lists the first different labels."""
    different = list(dict.fromkeys(np.asarray(labels).tolist()))
    return ", ".join(map(repr, different[:6])) + (", ..." if len(different) > 6 else "")
