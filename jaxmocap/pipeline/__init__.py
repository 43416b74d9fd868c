"""What a verb does with folders: synchronise, detect, calibrate, register, track; run folders, defaults, doctor."""

from ._batch import Batch as Batch, batch as batch
from ._calibrate import calibrate as calibrate
from ._defaults import (
    MaskRecord as MaskRecord,
    mask_record as mask_record,
    with_person_masks as with_person_masks,
    with_selected_frames as with_selected_frames,
)
from ._detect import FoundKeypoints as FoundKeypoints, detect as detect
from ._doctor import (
    EXTRAS as EXTRAS,
    WARMED as WARMED,
    Diagnosis as Diagnosis,
    doctor as doctor,
    warm_up as warm_up,
)
from ._keypoint_store import DETECTION_REPORT as DETECTION_REPORT
from ._made_to_measure import MadeBody as MadeBody, character_of as character_of, no_actor as no_actor
from ._register_and_learn import (
    Prepared as Prepared,
    fit_capture_appearance as fit_capture_appearance,
    register_and_learn as register_and_learn,
    registration_record as registration_record,
)
from ._run import RunResult as RunResult, run as run
from ._run_plan import PlannedStage as PlannedStage
from ._scan import ScannedActor as ScannedActor, scan as scan
from ._synchronise import sync as sync
from ._take_result import TakeResult as TakeResult
from ._track_capture import open_character as open_character, track_capture as track_capture
from ._workers import (
    Failure as Failure,
    check_workers as check_workers,
    on_workers as on_workers,
)
