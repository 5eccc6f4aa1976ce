import hashlib
import http.server
import threading
from functools import partial

import pytest

from skat.datasets.originals import Source, original_files

CONTENT = b"measured once\n"
HASH = hashlib.sha256(CONTENT).hexdigest()
NOWHERE = "http://127.0.0.1:9/"


def source(url=NOWHERE):
    return Source(folder="somewhere", url=url, hashes={"a.csv": HASH})


@pytest.fixture(autouse=True)
def no_data_home(monkeypatch):
    monkeypatch.delenv("SKAT_DATA_HOME", raising=False)


@pytest.fixture
def served(tmp_path):
    """A web server on this machine with the original file, and the requests that it got."""
    folder = tmp_path / "served"
    folder.mkdir()
    (folder / "a.csv").write_bytes(CONTENT)
    requests = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format, *arguments):
            requests.append(self.path)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=folder))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}/", requests, folder
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.parametrize("subfolder", ["somewhere", "somewhere/raw"])
def test_a_provided_file_comes_first(tmp_path, monkeypatch, subfolder):
    monkeypatch.setenv("SKAT_DATA_HOME", str(tmp_path / "mine"))
    for folder in (tmp_path / "mine" / subfolder, tmp_path / "cache" / "somewhere"):
        folder.mkdir(parents=True)
        (folder / "a.csv").write_bytes(CONTENT)
    found = original_files(source(), ["a.csv"], home=tmp_path / "cache")
    assert found == {"a.csv": tmp_path / "mine" / subfolder / "a.csv"}


def test_a_file_that_is_not_the_original_is_refused(tmp_path):
    (tmp_path / "somewhere").mkdir()
    (tmp_path / "somewhere" / "a.csv").write_bytes(b"edited\n")
    with pytest.raises(ValueError, match=f"is not the original file.*expected {HASH}"):
        original_files(source(), ["a.csv"], home=tmp_path)


def test_nothing_is_downloaded_when_that_is_not_wanted(tmp_path):
    with pytest.raises(OSError, match=r"1 of 1 files of somewhere .*download_if_missing=True"):
        original_files(source(), ["a.csv"], home=tmp_path, download_if_missing=False)


def test_downloads_once(tmp_path, served):
    url, requests, _ = served
    for _ in range(2):
        found = original_files(source(url), ["a.csv"], home=tmp_path / "cache")
        assert found["a.csv"].read_bytes() == CONTENT
    assert requests == ["/a.csv"]


def test_a_changed_download_is_refused_and_not_kept(tmp_path, served):
    url, _, folder = served
    (folder / "a.csv").write_bytes(b"edited\n")
    with pytest.raises(ValueError, match="hash"):
        original_files(source(url), ["a.csv"], home=tmp_path / "cache")
    assert not list((tmp_path / "cache").rglob("a.csv"))


def test_without_a_network_the_error_says_what_to_do(tmp_path):
    with pytest.raises(OSError, match=r"Could not download somewhere .* set SKAT_DATA_HOME"):
        original_files(source(), ["a.csv"], home=tmp_path)
