"""When videos started: by a flash, by their sound, or by the motion in them."""

from ._estimate import SURE as SURE
from ._person import (
    PersonHeights as PersonHeights,
    PersonOffset as PersonOffset,
    offset_by_person as offset_by_person,
)
from ._synchronise import (
    Progress as Progress,
    Span as Span,
    Synchronisation as Synchronisation,
    SyncMethod as SyncMethod,
    synchronise as synchronise,
)
