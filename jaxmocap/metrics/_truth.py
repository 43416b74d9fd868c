"""Ground truth on disk, read for evaluation only, and its values at the times of a result."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.motion import Motion, evened, read_npz

_SAME_INSTANT = 0.02  # of a sample interval: nearer than this, a sample is taken as it is
_LONGEST = 0.1  # seconds between samples that a straight line joins: a wrist at 10 m/s^2 is up to 1.25 cm off it


@dataclass(frozen=True)
class Truth:
    """Markers and joints of a capture on one time axis, NaN where not seen.

    Attributes:
        path: the file they were read from.
        times: seconds since the first camera's first frame; None means one sample per frame of its video.
        markers: points on the skin, metres.
        joints: metres, columns called `joint_names`.
        joint_names: their names.
        cam_from_world: the true pose of every camera at every sample, metres.
        has_our_joints: whether the joints are those of our skeleton, not of another rig or a detector.
    """

    path: Path
    times: Float[np.ndarray, " sample"] | None
    markers: Float[np.ndarray, "sample marker 3"] | None
    joints: Float[np.ndarray, "sample joint 3"] | None
    joint_names: tuple[str, ...]
    cam_from_world: Float[np.ndarray, "camera sample 4 4"] | None
    has_our_joints: bool = False

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> "Truth":
        """Read an npz with `markers` (N, M, 3), or `joints` (N, J, 3) and `joint_names`, or both; also `fps` or
        `timestamps` (N,), `cam_from_world` (C, N, 4, 4), and `joint_definitions`, "jaxmocap" where the joints are
        those of our skeleton. `InputError` if it has neither markers nor joints or shapes disagree."""
        path = Path(path)
        arrays = read_npz(path)
        markers, joints = arrays.get("markers"), arrays.get("joints")
        if markers is None and joints is None:
            raise InputError(f"The truth file {path} has neither markers nor joints; it needs one of them.")
        lengths = {}
        for name in ("markers", "joints"):
            if name not in arrays:
                continue
            values = arrays[name]
            if values.ndim != 3 or values.shape[2] != 3 or values.dtype.kind not in "fiu" or 0 in values.shape:
                raise InputError(f"{path}: {name} has shape {values.shape}; (frames, points, 3) numbers were expected.")
            lengths[name] = len(values)
        names = tuple(map(_text, np.atleast_1d(arrays.get("joint_names", ()))))
        if joints is not None and len(names) != joints.shape[1]:
            raise InputError(f"{path} has {joints.shape[1]} joints and {len(names)} joint_names; they must be as many.")
        definitions = arrays.get("joint_definitions")
        if definitions is not None and definitions.tolist() != "jaxmocap":
            raise InputError(
                f"{path}: joint_definitions is {definitions.tolist()!r}; 'jaxmocap' was expected where the joints are "
                "those of its skeleton; else leave it out."
            )
        cameras = arrays.get("cam_from_world")
        if cameras is not None:
            if cameras.ndim != 4 or cameras.shape[2:] != (4, 4) or cameras.dtype.kind not in "fiu":
                raise InputError(
                    f"{path}: cam_from_world has shape {cameras.shape}; (cameras, frames, 4, 4) numbers were expected."
                )
            lengths["cam_from_world"] = cameras.shape[1]
        times = _times(arrays, path, next(iter(lengths.values())))
        if times is not None:
            lengths["timestamps"] = len(times)
        if len(set(lengths.values())) > 1:
            found = ", ".join(f"{count} of {name}" for name, count in lengths.items())
            raise InputError(f"{path} has different numbers of frames: {found}; they must be equal.")
        return cls(path, times, markers, joints, names, cameras, definitions is not None)

    def at(self, motion: Motion) -> tuple["Truth", Motion]:
        """Bring both to the instants they share: the truth interpolated to the motion's frames, other frames dropped.

        Between samples more than a tenth of a second apart nothing is known: of a hole in the truth, or a truth of a
        few moments, only frames at a sample are kept. Raises `InputError` if they share none.
        """
        count = len(next(values for values in (self.markers, self.joints) if values is not None))
        if self.times is None:
            times, wanted, longest = np.arange(count, dtype=np.float64), motion.frames.astype(np.float64), 1.0
        else:
            times, wanted, longest = evened(self.times), evened(motion.timestamps), _LONGEST
        slack = _SAME_INSTANT * min(np.median(np.diff(times)) if count > 1 else 1.0, longest)
        covered = (wanted >= times[0] - slack) & (wanted <= times[-1] + slack)
        if not covered.any():
            unit = "frame" if self.times is None else "second"
            raise InputError(
                f"The truth {self.path} covers {unit}s {times[0]:g} to {times[-1]:g}, the result {wanted[0]:g} to "
                f"{wanted[-1]:g}; they share none, so this is the truth of another capture."
            )
        shared = covered & ~_in_hole(times, wanted, longest + slack, slack)
        if not shared.any():
            raise InputError(
                f"The truth {self.path} has no samples at the result's frames, or close enough to interpolate "
                f"({_LONGEST:g} s apart); evaluate frames that it has samples of."
            )
        wanted = wanted[shared]
        pick = lambda values: None if values is None else sample(times, values, wanted)  # noqa: E731
        cameras = None if self.cam_from_world is None else pick(self.cam_from_world.swapaxes(0, 1)).swapaxes(0, 1)
        truth = replace(
            self, times=wanted, markers=pick(self.markers), joints=pick(self.joints), cam_from_world=cameras
        )
        return truth, motion if shared.all() else motion[shared]

    def camera_pairs(self, motion: Motion) -> tuple[Float[np.ndarray, "pair 4 4"], Float[np.ndarray, "pair 4 4"]]:
        """Pair the poses of the motion's cameras with the true ones of the same frames, where both are known.

        Both must have cameras. Raises `InputError` if they are not as many or no pair is known.
        """
        assert self.cam_from_world is not None
        assert motion.cameras is not None
        ours = np.asarray(motion.cameras.cam_from_world, np.float64)
        if len(ours) != len(self.cam_from_world):
            raise InputError(
                f"The result has {len(ours)} cameras, the truth {self.path} has {len(self.cam_from_world)}; "
                "they must be the same cameras in the same order."
            )
        ours, true = ours.reshape(-1, 4, 4), self.cam_from_world.reshape(-1, 4, 4)
        known = np.isfinite(ours).all((1, 2)) & np.isfinite(true).all((1, 2))
        if not known.any():
            raise InputError(
                f"{self.path}: cam_from_world is known in none of the evaluated frames; give it or leave it out."
            )
        return ours[known], true[known]


def sample(
    times: Float[np.ndarray, " sample"], values: Float[np.ndarray, "sample *shape"], wanted: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "frame *shape"]:
    """Interpolate linearly along the first axis; NaN stays NaN.

    A sample within 2 % of an interval is taken as it is, and instants outside take the nearest sample.
    """
    if len(times) == 1:
        return np.repeat(values, len(wanted), axis=0)
    position = np.interp(wanted, times, np.arange(len(times)))
    position = np.where(np.abs(position - np.round(position)) < _SAME_INSTANT, np.round(position), position)
    before = np.minimum(position.astype(int), len(times) - 1)
    after = np.minimum(before + 1, len(times) - 1)
    weight = (position - before).reshape(-1, *[1] * (values.ndim - 1))
    first, second = np.asarray(values[before], np.float64), np.asarray(values[after], np.float64)
    return np.where(weight == 0, first, (1 - weight) * first + weight * second)


def _in_hole(times: np.ndarray, wanted: np.ndarray, longest: float, slack: float) -> np.ndarray:
    """Tell which instants lie between samples more than `longest` apart, and farther than `slack` from both."""
    after = np.clip(np.searchsorted(times, wanted), 1, None)
    before, after = times[after - 1], times[np.minimum(after, len(times) - 1)]
    return (after - before > longest) & (np.minimum(abs(wanted - before), abs(wanted - after)) > slack)


def _times(arrays: dict[str, np.ndarray], path: Path, count: int) -> np.ndarray | None:
    if "timestamps" in arrays:
        times = arrays["timestamps"]
        if times.dtype.kind not in "fiu":
            raise InputError(f"{path}: timestamps are of type {times.dtype}; numbers, seconds, were expected.")
        times = times.astype(np.float64)
        if times.ndim != 1 or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
            raise InputError(f"{path}: timestamps do not increase.")
        return times
    if "fps" not in arrays:
        return None
    fps = arrays["fps"]
    if fps.size != 1 or fps.dtype.kind not in "fiu" or not 0 < float(fps.reshape(())) < 1e5:
        raise InputError(f"{path}: fps is {fps}; one positive number was expected.")
    return np.arange(count) / float(fps.reshape(()))


def _text(name: str | bytes) -> str:
    return name.decode(errors="replace") if isinstance(name, bytes) else str(name)
