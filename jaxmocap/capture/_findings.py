"""What a check of a capture has to say."""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """One thing noticed about a capture. An error makes it unusable, a warning may cost accuracy, a note is a fact."""

    severity: Literal["error", "warning", "note"]
    where: str
    message: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.where}: {self.message}"
