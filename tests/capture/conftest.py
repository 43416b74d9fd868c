import os
import shutil
from pathlib import Path

import pytest
from small_captures import POSES, TOML, make_video, write_keypoints, write_mask, write_model


@pytest.fixture(scope="session")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("videos")
    for name in POSES:
        make_video(folder / f"{name}.mp4")
    return folder


@pytest.fixture
def small(tmp_path: Path, videos: Path) -> Path:
    """A complete, faultless capture of two cameras and 12 frames, to be spoilt by a test."""
    folder = tmp_path / "small"
    folder.mkdir()
    for name in POSES:
        shutil.copy(videos / f"{name}.mp4", folder)
    (folder / "capture.toml").write_text(TOML)
    write_model(folder / "cameras", POSES, 12)
    for name in ("keypoints", "masks"):
        (folder / name).mkdir()
    for frame in (0, 6):
        for name, pose in POSES.items():
            write_keypoints(folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json", pose)
            write_mask(folder / "masks" / f"{name}_{frame:05d}.png")
    return folder


@pytest.fixture
def data() -> Path:
    default = Path(__file__).parents[3] / "shared" / "data"
    folder = Path(os.environ.get("JAXMOCAP_DATA", default))
    if not (folder / "plaza").is_dir():
        pytest.skip(f"no captures at {folder}; set JAXMOCAP_DATA")
    return folder
