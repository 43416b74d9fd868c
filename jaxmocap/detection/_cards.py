"""Models that find a person's keypoints, each one card: its files by hash, the packages they lie in, its licence."""

from dataclasses import dataclass
from typing import Literal

from ._layouts import LayoutName

ModelName = Literal["heavy", "full"]


@dataclass(frozen=True)
class WeightFile:
    """One file of weights.

    Attributes:
        packed: its name inside a package or bundle.
        sha256: of the content, hexadecimal.
        size: bytes.
    """

    packed: str
    sha256: str
    size: int


@dataclass(frozen=True)
class Package:
    """A package that holds weights, to be downloaded by the client of its registry and never installed."""

    registry: Literal["npm", "PyPI"]
    name: str
    version: str


@dataclass(frozen=True)
class ModelCard:
    """A keypoint model.

    Attributes:
        title: as sentences name it.
        family: which code turns the numbers of its networks into points (`jaxmocap.detection.open_model`).
        layout: of its points.
        licence: of the weights.
        networks: by role, the files that will do; the same network may be packed in several ways.
        bundled: by role, the file's name in a bundle whose hashes are not listed here.
        packages: where the files come from, in the order in which they are tried.
        weak: what to say where it is used, if it is known to be worse than another card; "" if not.
    """

    title: str
    family: Literal["blazepose"]
    layout: LayoutName
    licence: str
    networks: dict[str, tuple[WeightFile, ...]]
    bundled: dict[str, str]
    packages: tuple[Package, ...]
    weak: str = ""


_PERSON = (
    WeightFile(
        "pose_solution_packed_assets.data",  # one file at offset 0, says pose_solution_packed_assets_loader.js
        "a63c614bef30d35947f13be361820b1e4e3bec9cfeebf4d11216a18373108e85",
        2_962_288,
    ),
    WeightFile("pose_detection.tflite", "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c", 2_959_046),
)
_BUNDLED = {"person": "pose_detector.tflite", "landmarks": "pose_landmarks_detector.tflite"}
_NPM = Package("npm", "@mediapipe/pose", "0.5.1675469404")
_PYPI = Package("PyPI", "mediapipe", "0.10.21")

# Bazarevsky et al. 2020, BlazePose; Google's model cards name the licence
CARDS: dict[ModelName, ModelCard] = {
    "heavy": ModelCard(
        title="BlazePose GHUM heavy",
        family="blazepose",
        layout="blazepose33",
        licence="Apache-2.0",
        networks={
            "person": _PERSON,
            "landmarks": (
                WeightFile(
                    "pose_landmark_heavy.tflite",
                    "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
                    27_709_200,
                ),
            ),
        },
        bundled=_BUNDLED,
        packages=(_NPM,),
    ),
    "full": ModelCard(
        title="BlazePose GHUM full",
        family="blazepose",
        layout="blazepose33",
        licence="Apache-2.0",
        networks={
            "person": _PERSON,
            "landmarks": (
                WeightFile(
                    "pose_landmark_full.tflite",
                    "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
                    6_440_512,
                ),
            ),
        },
        bundled=_BUNDLED,
        packages=(_NPM, _PYPI),
        weak="BlazePose GHUM full is less exact than heavy, and in some pictures sees a person who leans far over the "
        "wrong way round; look at the result.",
    ),
}
