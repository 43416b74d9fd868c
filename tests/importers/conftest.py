"""The dancing figure of tests/exporters, for these tests too."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "character"))
sys.path.insert(0, str(Path(__file__).parents[1] / "exporters"))

from dancing_figure import actor, character, even, motion  # noqa: F401
