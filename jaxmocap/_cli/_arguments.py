"""Arguments that several verbs share."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxmocap._results import InputError
from jaxmocap._spans import read_span

CapturePath = Annotated[
    Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE", help="Capture folder, or its capture.toml.")
]
CaptureOrVideos = Annotated[
    tuple[Path, ...],
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="CAPTURE | VIDEO ...",
        help="Capture folder, or its capture.toml; with --out two or more videos.",
        help_behavior_hint="",
    ),
]
NewCapture = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="DIR",
        help="New capture folder for a list of videos.",
        help_behavior_hint="(default: complete the capture in place)",
    ),
]
FrameSpan = Annotated[
    str | None,
    tyro.conf.arg(
        metavar="A:B",
        help="Only frames A to B - 1, counted from 0; either may be left out.",
        help_behavior_hint="(default: all)",
    ),
]
PoseFile = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE.json",
        help="Degrees of freedom fixed by hand at selected frames, in metres and degrees: "
        '{"0": {"root_ty": 0.1, "l_elbow_flex": 30}}.',
        help_behavior_hint="",
    ),
]
FindMasks = Annotated[
    bool,
    tyro.conf.arg(
        help_behavior_hint="",
        help="Where the capture has no mask, do not look for the person's outline: the fitted body stands for it.",
    ),
]
ActorFile = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="FILE.glb",
        help="Character to use, such as fit-character writes.",
        help_behavior_hint="(default: the capture's actor, else the built-in body)",
    ),
]
Height = Annotated[
    float | None,
    tyro.conf.arg(
        metavar="METRES",
        help="How tall the person is, where there is no actor: the built-in body is made to measure and keeps it.",
        help_behavior_hint="(default: found)",
    ),
]
DetectionsFolder = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="DIR",
        help="Let a detector's keypoints (files as the capture's may be) count beside the pixels.",
        help_behavior_hint="(default: pixels only)",
    ),
]
DetectionsFrames = Annotated[
    str | None,
    tyro.conf.arg(metavar="A:B", help="Use --detections only in these frames.", help_behavior_hint="(default: all)"),
]
Json = Annotated[bool, tyro.conf.arg(help="Print the answer as JSON, alone on standard output.", help_behavior_hint="")]
Seed = Annotated[int, tyro.conf.arg(metavar="N", help="Seed of all random numbers: same seed, same result.")]
Settings = Annotated[
    tuple[str, ...],
    tyro.conf.arg(
        name="set",
        metavar="NAME=VALUE ...",
        help="Change single settings, such as search.gating=off refine.rounds=6: attributes of Tracker, with dots.",
        help_behavior_hint="",
    ),
]
Preset = Annotated[
    Literal["draft", "normal", "paper"],  # as `Quality`, whose module brings JAX in
    tyro.conf.arg(help="A quick look, the best accuracy per second, or the published method and budget."),
]
Workers = Annotated[
    int | None,
    tyro.conf.arg(
        metavar="N",
        help="Processes, through Dask: more than one need the extra `cluster`.",
        help_behavior_hint="(default: with it one per four cores)",
    ),
]
Scheduler = Annotated[
    str | None,
    tyro.conf.arg(metavar="ADDRESS", help="A Dask cluster that is running, or its file.", help_behavior_hint=""),
]
Weights = Annotated[
    Path | None,
    tyro.conf.arg(
        metavar="PATH",
        help="The detector's networks, for a machine without a network.",
        help_behavior_hint="(default: downloaded once)",
    ),
]


def named_settings(texts: tuple[str, ...]) -> dict[str, str]:
    """Read `--set NAME=VALUE ...` as a dictionary."""
    found = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not (name and equals and value):
            raise InputError(f"--set has {text!r}; NAME=VALUE was expected, such as search.gating=off.")
        found[name] = value
    return found


def named_numbers(texts: tuple[str, ...], option: str, form: str, example: str) -> dict[str, float]:
    """Read `OPTION NAME=NUMBER ...` as a dictionary."""
    return {name: value for name, (value,) in named_places(texts, option, form, example).items()}


def named_places(texts: tuple[str, ...], option: str, form: str, example: str) -> dict[str, tuple[float, ...]]:
    """Read `OPTION NAME=NUMBER,NUMBER ...` as a dictionary; of as many numbers as `form` has, such as CAMERA=X,Y."""
    found = {}
    for text in texts:
        name, _, values = text.partition("=")
        try:
            found[name] = tuple(float(value) for value in values.split(","))
        except ValueError:
            found[name] = ()
        if len(found[name]) != form.count(",") + 1:
            raise InputError(f"{option} has {text!r}; {form} was expected, such as {example}.")
    return found


def person_pixels(texts: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Read `--person CAMERA=X,Y ...` as a dictionary."""
    return {name: (x, y) for name, (x, y) in named_places(texts, "--person", "CAMERA=X,Y", "cam0=430,250").items()}


def open_span(text: str | None, name: str = "--frames") -> tuple[int, int | None] | None:
    """Read `--frames A:B` as (A, B) where it is not yet known how many frames there are; B is None for the last."""
    if text is None:
        return None
    found = read_span(text)
    if found is None:
        raise InputError(f"{name} is {text!r}; A:B with whole numbers was expected, such as 10:40, 10: or :40.")
    return found


def frame_span(text: str | None, num_frames: int, name: str = "--frames") -> tuple[int, int] | None:
    """Read `--frames A:B` as (A, B) within a capture of `num_frames`; None for all frames."""
    span = open_span(text, name)
    if span is None:
        return None
    start, stop = span[0], num_frames if span[1] is None else span[1]
    if not start < stop <= num_frames:
        raise InputError(
            f"{name} is {text!r}, but the capture has {num_frames} frames: A:B needs 0 <= A < B <= {num_frames}."
        )
    return start, stop
