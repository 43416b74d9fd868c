"""When videos started: by a flash, by their sound, or by the motion in them."""

from ._estimate import SURE as SURE
from ._evidence import Progress as Progress
from ._synchronise import Synchronisation as Synchronisation, SyncMethod as SyncMethod, synchronise as synchronise
