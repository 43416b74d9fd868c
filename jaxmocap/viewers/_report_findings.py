"""What to know before a result is used, in sentences: how far it may be trusted, where, and what to look at first."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxmocap.camera import ranges
from jaxmocap.motion import Motion
from jaxmocap.verdict import GUIDE_ENTRIES

PASSED_OVER = "passed over"
FLASH_ENTRY, MASK_ENTRY = "A flash lights the picture", "A mask is doubtful"
"""Headings of the guide for what is no reason of a verdict on a tracked frame."""
_DOUBTFUL_MASK = 0.5
_LOOK_FIRST = 3
_MOST_RUNS = 8  # runs of frames that a sentence names
_USABLE = {("arm",): "legs and trunk", ("leg",): "arms and trunk", ("arm", "leg"): "trunk and head"}
"""What can be used where limbs of these kinds are lost."""
_WHY = {
    "lost": "nothing found there explains the pixels, or it moves too fast",
    "doubtful": "the covered pixels do not look like the person, part of the person stays uncovered, or the body moves "
    "implausibly fast",
    PASSED_OVER: "a flash lights the picture, so it was not looked at; the pose lies between its neighbours",
}


def frame_verdicts(motion: Motion) -> list[str]:
    """Judge each frame "ok", "doubtful", "lost" or "passed over", which is doubtful without energy and confidence."""
    known = [np.isfinite(values) for values in motion.energy.values()]
    unseen = ~np.any(known, axis=0) & (motion.confidence == 0).all(axis=1) if known else np.zeros(len(motion), bool)
    passed = unseen & (motion.status == "doubtful")
    return [PASSED_OVER if skipped else str(status) for skipped, status in zip(passed, motion.status, strict=True)]


def headline(motion: Motion) -> str:
    """Say the verdict in one sentence: how many frames may be trusted."""
    if not motion.energy and "lost" not in motion.provenance:
        return "This motion was not tracked in images: nothing here says how far it may be trusted."
    frames, limbs = motion.frames, np.zeros(len(motion), bool)
    for span in _limb_spans(motion):
        limbs |= (frames >= span["first"]) & (frames <= span["last"])
    good = int(((motion.status == "ok") & ~limbs).sum())
    if good == len(motion):
        return "The only frame can be trusted." if good == 1 else f"All {good} frames can be trusted."
    partly = int(((motion.status == "ok") & limbs).sum())
    besides = f" In {partly} more {_lost_limbs(motion)}." if partly else ""
    if good == 0:
        return f"No frame can be trusted{' as a whole' if partly else ''}.{besides}".replace("more ", "")
    return f"{good} of {len(motion)} frames can be trusted.{besides}"


def findings(motion: Motion) -> list[dict[str, Any]]:
    """List what to know before the result is used, the worst first: {kind, text, frames, entry}.

    `frames` are those to look at; `entry` is the heading under which the guide explains it, "" where it has none.
    """
    verdicts, spans = np.array(frame_verdicts(motion)), _spans(motion, "lost")
    found = []
    reasons = sorted({span["why"] for span in spans if span["part"] == "body"})
    doubts: dict[str, list[int]] = {}
    for span in _spans(motion, "doubts"):
        doubts.setdefault(span["why"], []).extend(_within(motion, span))
    for kind in ("lost", PASSED_OVER, "doubtful"):
        frames = motion.frames[verdicts == kind].tolist()
        if frames and kind == "doubtful" and doubts:
            for why, listed in doubts.items():
                text = f"Doubtful: {frames_said(sorted(set(listed)))}: {why}."
                found.append(_finding(kind, text, _starts(listed), GUIDE_ENTRIES.get(why, "")))
        elif frames:
            why = "; ".join(reasons) if kind == "lost" and reasons else _WHY[kind]
            entry = FLASH_ENTRY if kind == PASSED_OVER else GUIDE_ENTRIES.get(why, "")
            found.append(_finding(kind, f"{kind.capitalize()}: {frames_said(frames)}: {why}.", _starts(frames), entry))
    limbs: dict[tuple[str, str], list[int]] = {}
    for span in _limb_spans(motion):
        limbs.setdefault((span["part"], span["why"]), []).extend(_within(motion, span))
    for (part, why), frames in limbs.items():
        text = f"The {part} is lost in {frames_said(frames)}: {why}."
        found.append(_finding("lost", text, _starts(frames), GUIDE_ENTRIES.get(why, "")))
    found += _outlier_cameras(motion) + _doubtful_masks(motion)
    if motion.energy:
        first = motion.frames[_least_sure(motion, verdicts != PASSED_OVER)].tolist()
        found.append(_finding("note", f"Look first at {frames_said(first)}, where confidence is least.", first))
    return found


def selected_fits(motion: Motion) -> list[tuple[int, dict[str, Any]]]:
    """Frame number and fit of each selected frame: the record counts frames that all cameras share, we the first
    camera's, in which the same frames have other numbers."""
    fits = sorted((motion.provenance.get("registration") or {}).items(), key=lambda item: int(item[0]))
    numbers = (motion.provenance.get("selected_frames") or {}).get("frames") or []
    if len(numbers) != len(fits):
        numbers = [int(frame) for frame, _ in fits]
    return [(number, fit) for number, (_, fit) in zip(sorted(numbers), fits, strict=True)]


def _lost_limbs(motion: Motion) -> str:
    """Say what is lost in the frames that are otherwise trusted, and what can be used there."""
    trusted = set(motion.frames[motion.status == "ok"].tolist())
    parts = sorted({span["part"] for span in _limb_spans(motion) if trusted & set(_within(motion, span))})
    kinds = tuple(sorted({part.rpartition(" ")[2] for part in parts}))
    rest = _USABLE.get(kinds, "the rest")
    if len(parts) == 1:
        return f"the {parts[0]} is lost, and the rest can be used"
    return f"limbs are lost ({', '.join(parts)}), and {rest} can be used"


def _limb_spans(motion: Motion) -> list[dict[str, Any]]:
    return [span for span in _spans(motion, "lost") if span["part"] != "body"]


def _spans(motion: Motion, kind: str) -> list[dict[str, Any]]:
    """List the recorded spans that have frames in this motion, which may be a part of what was tracked."""
    return [span for span in motion.provenance.get(kind) or [] if _within(motion, span)]


def _within(motion: Motion, span: Mapping[str, Any]) -> list[int]:
    """List the motion's frames in a span of the record."""
    return motion.frames[(motion.frames >= span["first"]) & (motion.frames <= span["last"])].tolist()


def _least_sure(motion: Motion, looked_at: np.ndarray) -> list[int]:
    """Pick a few positions of least mean confidence, apart from each other so that they are different moments."""
    sure = np.where(looked_at, motion.confidence.mean(axis=1), np.inf)
    picked: list[int] = []
    while len(picked) < _LOOK_FIRST and np.isfinite(sure).any():
        worst = int(np.argmin(sure))
        picked.append(worst)
        apart = max(len(motion) // 10, 1)
        sure[max(worst - apart, 0) : worst + apart + 1] = np.inf
    return sorted(picked)


def _outlier_cameras(motion: Motion) -> list[dict[str, Any]]:
    frames: dict[tuple[str, str], list[int]] = {}
    for span in _spans(motion, "outlier_cameras"):
        frames.setdefault((span["camera"], span["why"]), []).extend(_within(motion, span))
    return [
        _finding(
            "doubtful",
            f"Camera {camera} is left out of the verdict in {frames_said(listed)}: {why}.",
            _starts(listed),
            GUIDE_ENTRIES.get(why, ""),
        )
        for (camera, why), listed in frames.items()
    ]


def _doubtful_masks(motion: Motion) -> list[dict[str, Any]]:
    found = []
    for frame, fit in selected_fits(motion):
        for camera, mask in fit["masks"].items():
            if mask.get("confidence", 1.0) < _DOUBTFUL_MASK:
                text = f"The mask of {camera} at selected frame {frame} was found with confidence "
                text += f"{mask['confidence']:.2f}: look at it, for colours are learnt there."
                found.append(_finding("doubtful", text, [frame], MASK_ENTRY))
    return found


def _finding(kind: str, text: str, frames: Sequence[int], entry: str = "") -> dict[str, Any]:
    return {"kind": kind, "text": text, "frames": list(frames), "entry": entry}


def frames_said(frames: Sequence[int]) -> str:
    runs = ranges(list(frames)).split(", ")
    more = f" and {len(runs) - _MOST_RUNS} places more" if len(runs) > _MOST_RUNS + 2 else ""
    return f"frame{'s' * (len(frames) > 1)} {', '.join(runs[:_MOST_RUNS] if more else runs)}{more}"


def _starts(frames: Sequence[int]) -> list[int]:
    """List the first frame of each run, a handful of them."""
    known = set(frames)
    return [frame for frame in sorted(known) if frame - 1 not in known][:_MOST_RUNS]
