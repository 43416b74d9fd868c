import os
from pathlib import Path

import pytest


@pytest.fixture
def data() -> Path:
    default = Path(__file__).parents[3] / "shared" / "data"
    folder = Path(os.environ.get("JAXMOCAP_DATA", default))
    if not (folder / "plaza").is_dir():
        pytest.skip(f"no captures at {folder}; set JAXMOCAP_DATA")
    return folder
