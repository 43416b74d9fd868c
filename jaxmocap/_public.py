"""The public vocabulary, in the order of the pipeline."""
# ruff: noqa: I001

from .capture import (
    Capture as Capture,
    Detections as Detections,
    Finding as Finding,
    Synchronisation as Synchronisation,
    check as check,
    choose_frames as choose_frames,
)
from jaxmocap.pipeline import sync as sync
from jaxmocap.pipeline import FoundKeypoints as FoundKeypoints, detect as detect
from .camera import Cameras as Cameras, read_cameras as read_cameras, write_cameras as write_cameras
from .calibration import Calibration as Calibration, adopt_cameras as adopt_cameras
from jaxmocap.pipeline import calibrate as calibrate
from .annotation import AnnotationPage as AnnotationPage, annotate as annotate
from .character import Character as Character, Pose as Pose, Skeleton as Skeleton
from .rigging import RiggedMesh as RiggedMesh, body as body, open_actor as open_actor, rig as rig
from jaxmocap.pipeline import ScannedActor as ScannedActor, scan as scan
from .appearance import Appearance as Appearance
from .observation import Observations as Observations
from jaxmocap.pipeline import fit_capture_appearance as fit_capture_appearance
from jaxmocap._types import knob as knob
from .render import SoftSettings as SoftSettings
from .energies import SearchEnergy as SearchEnergy, search_energy as search_energy, soft_score as soft_score
from .samplers import (
    CrossEntropy as CrossEntropy,
    InteractingSimulatedAnnealing as InteractingSimulatedAnnealing,
    RandomSearch as RandomSearch,
)
from .refiners import LeastSquares as LeastSquares, Shooting as Shooting
from .motion import Motion as Motion
from .track import Tracker as Tracker, track as track, with_settings as with_settings
from jaxmocap.registration import CharacterFit as CharacterFit
from jaxmocap.registration import CharacterFitSettings as CharacterFitSettings
from jaxmocap.search import PolishPlan as PolishPlan
from jaxmocap.registration import Registration as Registration
from jaxmocap.refinement import DetectionPlan as DetectionPlan
from jaxmocap.appearance import appearance_preset as appearance_preset
from jaxmocap.registration import fit_character as fit_character
from jaxmocap.observation import observe as observe
from jaxmocap.search import polish as polish
from jaxmocap.registration import read_pose_file as read_pose_file
from jaxmocap.registration import masks_of as masks_of
from jaxmocap.registration import register as register
from jaxmocap.registration import segment_person as segment_person
from .calibration import (
    RefinedCameras as RefinedCameras,
    refine_cameras as refine_cameras,
    scale_cameras as scale_cameras,
)
from .metrics import evaluate as evaluate
from .datasets import import_dataset as import_dataset
from .exporters import export as export
from .importers import read_motion as read_motion
from .viewers import (
    contact_sheet as contact_sheet,
    draw_character as draw_character,
    draw_overlay as draw_overlay,
    overlay_videos as overlay_videos,
    report_page as report_page,
    rig_pictures as rig_pictures,
    view as view,
    write_rerun as write_rerun,
)
from jaxmocap.pipeline import track_capture as track_capture
from jaxmocap.pipeline import RunResult as RunResult, run as run
from jaxmocap.pipeline import Batch as Batch, TakeResult as TakeResult, batch as batch
from jaxmocap.pipeline import Diagnosis as Diagnosis
from jaxmocap.pipeline import doctor as doctor
from .experiments import Benchmark as Benchmark, bench as bench
