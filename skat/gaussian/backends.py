"""Moments and maps of rows wherever the rows live: in NumPy, behind the array API, or in dask.

Whatever the size of the data is done where the data are; what has the size of the features is done in NumPy.
"""

from typing import Any

import numpy as np

from skat._compat import (
    convert_to_numpy,
    get_namespace_and_device,
    is_numpy_namespace,
    supported_float_dtypes,
)
from skat.gaussian.moments import Moments, SideBySide, held_well, row_moments

__all__ = ["apply_map", "beside", "is_dask", "moments_of", "on_host", "to_namespace"]


def is_dask(X: Any) -> bool:
    """Whether rows are a dask array, data frame or series; without importing dask."""
    return type(X).__module__.partition(".")[0] in {"dask", "dask_expr"}


def moments_of(sides: Any) -> Any:
    """Return the moments of several sets of rows, computed together.

    Parameters
    ----------
    sides : sequence of (rows, weight)
        Rows of shape (n_rows, n_features) or None, and weights of shape (n_rows,) or None.

    Returns
    -------
    list of Moments
        None for a set that is None or in which no row has weight.
    """
    lazy = [_lazy_moments(rows, weight) if is_dask(rows) else None for rows, weight in sides]
    if any(part is not None for part in lazy):
        from dask.base import compute

        lazy = list(compute(*lazy))
    return [
        done if is_dask(rows) else _eager_moments(rows, weight) for done, (rows, weight) in zip(lazy, sides)
    ]


def apply_map(affine: Any, X: Any, *, keep: Any = None, check: Any = None) -> Any:
    """Return rows carried over by a map, as the same kind of container, lazily for dask.

    Parameters
    ----------
    affine : AffineMap
        The map.
    X : array-like of shape (n_rows, n_features)
        Rows in NumPy, another array library, or dask.
    keep : array-like of bool of shape (n_rows,), default=None
        Rows to be returned unchanged.
    check : callable, default=None
        Called with rows, in NumPy, whose image is not finite.

    Returns
    -------
    array of shape (n_rows, n_features)
    """
    if is_dask(X):
        return _apply_lazily(affine, X, keep, check)
    xp, _, device = get_namespace_and_device(X)
    if not is_numpy_namespace(xp):
        return _apply_on_device(affine, X, keep, check, xp, device)
    # NaN or infinity in a row reaches its image, so one sum over the result checks the input, too.
    with np.errstate(over="ignore", invalid="ignore"):
        if keep is None:
            carried = affine(X)
        else:
            keep = np.asarray(keep, dtype=bool)
            carried = np.array(X, dtype=X.dtype if X.dtype == np.float32 else np.float64)
            if not keep.all():
                carried[~keep] = affine(X[~keep])
        if check is not None and not np.isfinite(carried.sum()) and not np.isfinite(carried).all():
            check(X)
    return carried


def beside(X: Any, y: Any) -> Any:
    """Return the columns of both, side by side."""
    if is_dask(X) or is_dask(y):
        import dask.array as da

        X, y = _dask_array(X), _dask_array(y)
        return da.concatenate([X, y.rechunk({0: X.chunks[0]})], axis=1)
    xp, _, _ = get_namespace_and_device(X, y)
    return SideBySide(X, y) if is_numpy_namespace(xp) else xp.concat([X, y], axis=1)


def on_host(array: Any) -> Any:
    """Return any array as one in NumPy."""
    if is_dask(array):
        array = array.compute()
    xp, is_array_api, _ = get_namespace_and_device(array)
    return np.asarray(convert_to_numpy(array, xp) if is_array_api else array)


def to_namespace(array: Any, like: Any) -> Any:
    """Return a NumPy array as an array of the library and device that another one has."""
    if is_dask(like):
        return array
    xp, _, device = get_namespace_and_device(like)
    if is_numpy_namespace(xp):
        return array
    return xp.asarray(array.astype(_name(_widest(xp, device))), device=device)


def _name(dtype: Any) -> str:
    """Return a type's name in NumPy, whichever library's it is."""
    return str(dtype).rpartition(".")[2]


def _eager_moments(rows: Any, weight: Any) -> Any:
    if rows is None:
        return None
    if not isinstance(rows, SideBySide):
        xp, _, device = get_namespace_and_device(rows)
        if not is_numpy_namespace(xp):
            return _device_moments(rows, weight, xp, device)
    if weight is not None and not np.any(weight):
        return None
    return row_moments(rows, weight)


def _widest(xp: Any, device: Any) -> Any:
    return supported_float_dtypes(xp, device)[0]


def _device_moments(rows: Any, weight: Any, xp: Any, device: Any) -> Any:
    """Return moments computed on the rows' own device: by a product of the rows, by QR where that loses digits."""
    dtype, eps = _widest(xp, device), float(xp.finfo(rows.dtype).eps)
    rows = xp.astype(rows, dtype, copy=False)
    n_rows, heaviest = rows.shape[0], 0
    if weight is None:
        total = squared = float(n_rows)
    else:
        host_weight = np.asarray(
            convert_to_numpy(weight, get_namespace_and_device(weight)[0]), dtype=np.float64
        )
        n_rows, heaviest = int(np.count_nonzero(host_weight)), int(np.argmax(host_weight))
        total, squared = float(host_weight.sum()), float(host_weight @ host_weight)
        weight = xp.asarray(weight, dtype=dtype, device=device)

    def host(array: Any) -> Any:
        return np.asarray(convert_to_numpy(array, xp), dtype=np.float64)

    # A row without weight may be anywhere, and would take the digits of the others.
    shift = rows[heaviest, :]
    shifted = rows - shift
    offset = xp.sum(shifted, axis=0) / n_rows if weight is None else (weight @ shifted) / total
    shifted = shifted - offset
    if weight is not None:
        shifted = xp.sqrt(weight)[:, None] * shifted
    host_shift, host_offset = host(shift), host(offset)
    mean = host_shift + host_offset
    remainder = host_offset - (mean - host_shift)
    if shifted.shape[0] <= shifted.shape[1]:
        return Moments(n_rows, total, squared, mean, remainder, factor=host(shifted), eps=eps)

    def row_factor() -> Any:
        return host(xp.linalg.qr(shifted, mode="reduced")[1])

    if dtype != xp.float64:
        return Moments(n_rows, total, squared, mean, remainder, factor=row_factor(), eps=eps)
    scatter = host(shifted.T @ shifted)
    return held_well(Moments(n_rows, total, squared, mean, remainder, scatter, eps=eps), row_factor)


def _apply_on_device(affine: Any, X: Any, keep: Any, check: Any, xp: Any, device: Any) -> Any:
    working = X.dtype if affine.is_tame else _widest(xp, device)
    rows = xp.astype(X, working, copy=False)
    coef, source_mean, target_mean = (
        xp.asarray(part, device=device) for part in affine.rounded(_name(working))
    )
    carried = (rows - source_mean) @ coef.T + target_mean
    if affine.untouched is not None:
        untouched = xp.asarray(affine.untouched, device=device)[None, :]
        carried = xp.where(untouched, rows, carried)
    if keep is not None:
        carried = xp.where(xp.asarray(keep, device=device)[:, None], rows, carried)
    # NaN or infinity in a row reaches its image, and so the sum of all.
    if (
        check is not None
        and not bool(xp.isfinite(xp.sum(carried)))
        and not bool(xp.all(xp.isfinite(carried)))
    ):
        check(convert_to_numpy(X, xp))
    return xp.astype(carried, X.dtype, copy=False)


def _lazy_moments(X: Any, weight: Any) -> Any:
    """Return a delayed value: the moments of dask rows, merged pairwise over their blocks."""
    from dask.delayed import delayed

    blocks = _row_blocks(X)
    weights = [None] * len(blocks) if weight is None else _row_blocks(_aligned(weight, X))
    if len(weights) != len(blocks):
        raise ValueError(
            f"rows and their weights must be partitioned alike; there are {len(blocks)} and {len(weights)} "
            "blocks."
        )
    level = [delayed(_block_moments)(block, part) for block, part in zip(blocks, weights)]
    while len(level) > 1:
        level = [delayed(_merged)(level[start : start + 2]) for start in range(0, len(level), 2)]
    return level[0]


def _block_moments(block: Any, weight: Any) -> Any:
    rows = np.asarray(block)
    if not np.issubdtype(rows.dtype, np.floating):
        rows = rows.astype(np.float64)
    weight = None if weight is None else np.asarray(weight, dtype=np.float64)
    if len(rows) == 0 or (weight is not None and not weight.any()):
        return None
    return row_moments(rows, weight)


def _merged(parts: Any) -> Any:
    parts = [part for part in parts if part is not None]
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]


def _row_blocks(X: Any) -> Any:
    """Return the blocks of rows of a dask container as delayed values."""
    if not hasattr(X, "chunks"):
        return X.to_delayed()
    if X.ndim == 2:
        X = X.rechunk({1: -1})
    return list(X.to_delayed().ravel())


def _aligned(values: Any, X: Any) -> Any:
    """Return one value per row, partitioned like the rows."""
    if is_dask(values) and not (hasattr(values, "chunks") and hasattr(X, "chunks")):
        return values
    if not hasattr(X, "chunks") or np.isnan(X.chunks[0]).any():
        if is_dask(values):
            return values
        raise ValueError(
            "the number of rows in each dask partition is unknown, so values in NumPy cannot be laid beside "
            "them. "
            "Give a dask series of the same partitions, or a dask array of known chunks."
        )
    import dask.array as da

    values = values if is_dask(values) else da.from_array(np.asarray(values), chunks=(X.chunks[0],))
    return values.rechunk((X.chunks[0],))


def _dask_array(X: Any) -> Any:
    import dask.array as da

    if not is_dask(X):
        return da.from_array(X, chunks=X.shape)
    return X if hasattr(X, "chunks") else X.to_dask_array(lengths=True)


def _apply_lazily(affine: Any, X: Any, keep: Any, check: Any) -> Any:
    if not hasattr(X, "chunks"):
        if keep is None:
            return X.map_partitions(_carried_frame, affine, check=check, meta=X._meta.astype(float))
        return X.map_partitions(
            _carried_frame,
            affine,
            _aligned(keep, X),
            check=check,
            meta=X._meta.astype(float),
            align_dataframes=False,
        )
    import dask.array as da

    X = X.rechunk({1: -1})
    dtype = np.float32 if X.dtype == np.float32 else np.float64
    if keep is None:
        return X.map_blocks(
            _carried_block, affine=affine, check=check, dtype=dtype, meta=np.empty((0, 0), dtype)
        )
    return da.map_blocks(
        _carried_block,
        X,
        _aligned(keep, X)[:, np.newaxis],
        affine=affine,
        check=check,
        dtype=dtype,
        meta=np.empty((0, 0), dtype),
    )


def _carried_block(block: Any, keep: Any = None, *, affine: Any, check: Any) -> Any:
    rows = np.asarray(block)
    return apply_map(affine, rows, keep=None if keep is None else np.asarray(keep)[:, 0], check=check)


def _carried_frame(frame: Any, affine: Any, keep: Any = None, *, check: Any) -> Any:
    rows = frame.to_numpy()
    carried = apply_map(affine, rows, keep=keep, check=check)
    return type(frame)(carried, index=frame.index, columns=frame.columns)
