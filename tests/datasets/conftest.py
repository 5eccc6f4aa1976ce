import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def measured_data():
    """Folder with the originals and their tidied copies; the tests never download anything."""
    home = os.environ.get("SKAT_DATA_HOME")
    if not home:
        pytest.skip("SKAT_DATA_HOME is not set: no measured data on this machine")
    return Path(home)
