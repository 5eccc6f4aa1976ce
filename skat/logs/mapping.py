"""What the user says of names and units: options and map.toml."""


def read_map(maps=(), path=None):
    """Return the mapping for `load_log`'s ``columns`` from options and a file.

    Parameters
    ----------
    maps : sequence of str
        ``NAME=THEIRS[:UNIT]`` each, as ``--map`` takes them; they come before the file's. ``NAME=:UNIT`` says the
        unit alone.
    path : path, default=None
        A ``map.toml``.

    Returns
    -------
    dict from str to str
    """
    raise NotImplementedError


def write_map(path, log, *, force=False):
    """Write which column of a log stands for what, as a map.toml that `load_log` takes as ``columns``.

    Parameters
    ----------
    path : path
    log : Log
    force : bool, default=False
        Whether to overwrite a file that exists.

    Returns
    -------
    Path
    """
    raise NotImplementedError
