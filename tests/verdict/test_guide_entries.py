"""Every reason of a verdict is explained in the guide, under the heading that the report page names."""

import re
from pathlib import Path

from jaxmocap.verdict import GUIDE_ENTRIES, _doubts, _lost, _outlier_camera
from jaxmocap.viewers._report_findings import FLASH_ENTRY, MASK_ENTRY

GUIDE = Path(__file__).parents[2] / "docs" / "guide.md"


def explained() -> dict[str, str]:
    """Text by heading, of those below "Reasons and what to do"."""
    section = re.search(r"^### Reasons and what to do\n(.*?)(?=^##? )", GUIDE.read_text(), re.M | re.S)[1]
    parts = re.split(r"^#### (.+)\n", section, flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_every_reason_has_an_entry():
    """Reasons are the sentences that these modules hold."""
    reasons = {
        text
        for module in (_doubts, _lost, _outlier_camera)
        for name, text in vars(module).items()
        if name.isupper() and isinstance(text, str)
    }
    assert len(reasons) == 12
    assert set(GUIDE_ENTRIES) == reasons


def test_every_entry_is_a_heading_of_the_guide_with_sentences_below_it():
    found = explained()
    assert set(found) == {*GUIDE_ENTRIES.values(), FLASH_ENTRY, MASK_ENTRY}
    assert len(set(GUIDE_ENTRIES.values())) == len(GUIDE_ENTRIES)
    assert [heading for heading, text in found.items() if text.count(".") < 2] == []
