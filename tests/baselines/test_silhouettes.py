"""The silhouette baselines with all that is true, the masks and the pose of the frame before: five cameras all around
leave nothing open, so that a fair implementation finds the person."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxmocap.baselines import PoseCut, SegmentAndFit
from jaxmocap.character import skin
from jaxmocap.observation import Frame, FrameImages, build_problem, frame_rectangle, surface_of
from jaxmocap.synthetic import make_capture

CAMERAS, FRAME = 5, 1


@pytest.fixture(scope="module")
def filmed():
    return make_capture(
        2,
        (240, 136),
        CAMERAS,
        fps=15.0,
        view_angle_degrees=360 / CAMERAS,
        motion_scale=1.5,
        supersampling=1,
        selected_frames=(0,),
    )


def given(filmed):
    """The true masks, as a source of masks."""
    return lambda camera, frame: filmed.masks[frame, camera]


def off(filmed, pose) -> float:
    """Mean distance of the skin to where it is, centimetres."""
    apart = skin(filmed.character, pose) - skin(filmed.character, filmed.pose(FRAME))
    return 100 * float(np.linalg.norm(np.asarray(apart), axis=1).mean())


def found(filmed, baseline) -> float:
    """The error of what a baseline finds from the true pose of the frame before. All views have masks, so that no
    colours are learnt."""
    character, cameras, start = filmed.character, filmed.cameras, filmed.pose(FRAME - 1)
    vertices = np.asarray(skin(character, start))
    shown = FrameImages(FRAME, float(filmed.timestamps[FRAME]), list(filmed.images[FRAME]))
    rectangle = frame_rectangle(vertices, cameras, FRAME)
    surface = surface_of(character, None, CAMERAS)
    problem = build_problem(shown.images, rectangle, cameras, FRAME, vertices, surface)
    unknown = [None] * CAMERAS
    memory = (None, unknown) if isinstance(baseline, PoseCut) else unknown
    worker = SimpleNamespace(character=character, cameras=cameras, memory=memory)
    return off(filmed, baseline.find(worker, Frame(shown, rectangle, problem), start))


def test_she_has_moved_by_centimetres(filmed):
    assert off(filmed, filmed.pose(FRAME - 1)) > 3.0


@pytest.mark.slow
def test_segment_and_fit_finds_her_with_all_that_is_true(filmed):
    assert found(filmed, SegmentAndFit(iterations=2, masks=given(filmed))) < 2.0


@pytest.mark.slow
def test_posecut_finds_her_with_all_that_is_true(filmed):
    assert found(filmed, PoseCut(masks=given(filmed), pixels=2000)) < 2.0
