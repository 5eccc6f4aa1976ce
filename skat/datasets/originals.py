"""Where the original files of measured data are found, and proof that they are the originals."""

import gzip
import hashlib
import os
import zlib
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from os import PathLike
from pathlib import Path


@dataclass(frozen=True)
class Source:
    """Public files at one commit of a repository, with their hashes.

    Parameters
    ----------
    folder : str
        Name of the data set's folder, in ``$SKAT_DATA_HOME`` and in the cache.

    url : str
        Folder at the pinned commit from which the files are downloaded.

    hashes : mapping of str to str
        File name to SHA-256, as hexadecimal digits.

    paths : mapping of str to str
        File name to the path below `url`, of those that have another name there.
    """

    folder: str
    url: str
    hashes: Mapping[str, str]
    paths: Mapping[str, str] = field(default_factory=dict)


def data_home(path: str | PathLike[str] | None = None) -> Path:
    """Return the folder into which measured data are downloaded.

    Parameters
    ----------
    path : str or Path, default=None
        The folder to use. None means the user's cache folder.

    Returns
    -------
    Path
        The folder; it need not exist yet.
    """
    import pooch

    return Path(path) if path is not None else Path(pooch.os_cache("skat"))


def original_files(
    source: Source,
    names: Iterable[str],
    *,
    home: str | PathLike[str] | None = None,
    download_if_missing: bool = True,
) -> dict[str, Path]:
    """Return verified copies of original files, downloading those that are not there yet.

    A file is looked for in ``$SKAT_DATA_HOME/<folder>``, there also in ``raw/``, then in the cache; also compressed by
    gzip, with another ending ``.gz``. Whatever is found or downloaded must have the hash of the original.

    Parameters
    ----------
    source : Source
        Where the files come from.

    names : iterable of str
        Which of the files of `source` are wanted.

    home : str or Path, default=None
        The cache folder; see `data_home`.

    download_if_missing : bool, default=True
        Whether the network may be used.

    Returns
    -------
    dict of str to Path
        The files by name, in the order of `names`.

    Raises
    ------
    OSError
        If a file is not there and may not or cannot be downloaded.

    ValueError
        If a file is there but is not the original.
    """
    cache = data_home(home) / source.folder
    found = {name: _present(source, name, cache) for name in names}
    missing = [name for name, path in found.items() if path is None]
    if missing and not download_if_missing:
        raise OSError(
            f"{len(missing)} of {len(found)} files of {source.folder} are not on this machine "
            f"(first: {missing[0]}): "
            f"neither in $SKAT_DATA_HOME ({os.environ.get('SKAT_DATA_HOME') or 'not set'}) nor in {cache}. "
            "Call again with download_if_missing=True to download them."
        )
    if missing:
        found.update(_download(source, missing, cache))
    return {name: Path(path) for name, path in found.items() if path is not None}


def verified(path: str | PathLike[str], sha256: str) -> Path:
    """Return a path after checking that the file has the expected hash.

    Parameters
    ----------
    path : Path
        An existing file.

    sha256 : str
        The hash it should have, as hexadecimal digits; where the path ends in ``.gz``, what is compressed there.

    Returns
    -------
    Path
        The same path.

    Raises
    ------
    ValueError
        If the hash differs.
    """
    content = Path(path).read_bytes()
    if Path(path).suffix == ".gz":
        try:
            content = gzip.decompress(content)
        except (EOFError, zlib.error, gzip.BadGzipFile):
            content = b""
    actual = hashlib.sha256(content).hexdigest()
    if actual != sha256:
        raise ValueError(
            f"{path} is not the original file: its SHA-256 is {actual}, expected {sha256}. "
            "Remove it, so that the original is downloaded."
        )
    return Path(path)


def provided(folder: str) -> Path | None:
    """Return the folder of a data set below ``$SKAT_DATA_HOME``, or None where there is none.

    Parameters
    ----------
    folder : str
        Name of the data set's folder.

    Returns
    -------
    Path or None
        The folder, if the variable is set and the folder exists.
    """
    home = os.environ.get("SKAT_DATA_HOME")
    return path if home and (path := Path(home) / folder).is_dir() else None


def _present(source: Source, name: str, cache: Path) -> Path | None:
    mine = provided(source.folder)
    places = [cache / name] if mine is None else [mine / name, mine / "raw" / name, cache / name]
    places = [form for place in places for form in (place, place.with_name(f"{place.name}.gz"))]
    return next((verified(place, source.hashes[name]) for place in places if place.is_file()), None)


def _download(source: Source, names: Iterable[str], cache: Path) -> dict[str, Path]:
    import pooch

    fetcher = pooch.create(
        cache,
        source.url,
        registry={name: source.hashes[name] for name in names},
        urls={name: source.url + source.paths[name] for name in names if name in source.paths},
    )
    fetch = partial(fetcher.fetch, downloader=pooch.HTTPDownloader(timeout=30))
    log = pooch.get_logger()
    level = log.level
    log.setLevel("WARNING")
    try:
        with ThreadPoolExecutor(max_workers=8) as pool:
            return {name: Path(path) for name, path in zip(names, pool.map(fetch, names))}
    except OSError as error:  # requests' errors are OSErrors too
        raise OSError(
            f"Could not download {source.folder} from {source.url}: {error}. Check the network, or put the "
            f"files into a folder {source.folder}/ and set SKAT_DATA_HOME to the folder that holds it."
        ) from error
    finally:
        log.setLevel(level)
