"""A small capture to annotate, with cameras and a person of known size, and a browser that is none."""

from collections.abc import Callable
from pathlib import Path

import pytest
from annotation_client import Client
from small_captures import POSES, TOML, make_video, write_keypoints, write_model

from jaxmocap.annotation import AnnotationPage, annotate


@pytest.fixture(scope="session")
def videos(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("videos")
    for name in POSES:
        make_video(folder / f"{name}.mp4")
    return folder


@pytest.fixture
def capture(tmp_path, videos) -> Path:
    """With a detector's keypoints at its selected frames, 0 and 6."""
    folder = tmp_path / "small"
    (folder / "keypoints").mkdir(parents=True)
    write_model(folder / "cameras", POSES, 12)
    for name, pose in POSES.items():
        (folder / f"{name}.mp4").symlink_to(videos / f"{name}.mp4")
        for frame in (0, 6):
            write_keypoints(folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json", pose)
    (folder / "capture.toml").write_text(TOML.replace('masks = "masks"\n', ""))
    return folder


@pytest.fixture
def bare(capture) -> Path:
    """Two videos and nothing else; the configuration has a comment."""
    text = (capture / "capture.toml").read_text()
    for line in ('cameras = "cameras"\n', "selected_frames = [0, 6]\n", 'keypoints = "keypoints"\n'):
        text = text.replace(line, "")
    (capture / "capture.toml").write_text(f"# filmed in May\r\n{text}")
    for file in (capture / "keypoints").iterdir():
        file.unlink()
    (capture / "keypoints").rmdir()
    return capture


@pytest.fixture
def serve():
    """Serves a capture; ends when the test does."""
    pages: list[AnnotationPage] = []

    def start(*arguments, **options) -> tuple[AnnotationPage, Client]:
        pages.append(annotate(*arguments, port=0, **options))
        return pages[-1], Client(pages[-1].url)

    start: Callable
    yield start
    for page in pages:
        page.stop()
