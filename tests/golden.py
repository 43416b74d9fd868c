"""Results that are kept: what tracking found when somebody last looked at it and was content.

`JAXMOCAP_RENEW_GOLDEN=1 pytest -n 0 -m slow -k golden tests/track` writes them anew. There is a file per backend, since
another one adds in another order and its search ends elsewhere. Another processor does so too: before you look for what
moved a result, see whether it has moved without your change.
"""

import json
import os
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxmocap._files import write_text
from jaxmocap.motion import Motion

FOLDER = Path(__file__).parent / "golden_results"
MEAN_MM, ROOT_MEAN_SQUARE_DEGREES = 2.0, 1.0
RENEW = "JAXMOCAP_RENEW_GOLDEN"


def hold_against_golden(motion: Motion, name: str) -> None:
    """Joints within 2 mm in the mean and joint angles within 1 degree (RMS) of the kept ones."""
    path = FOLDER / f"{name}_{jax.default_backend()}.json"
    names, angles = list(motion.character.skeleton.dof_names[6:]), np.degrees(motion.angles.astype(float))
    if os.environ.get(RENEW):
        path.parent.mkdir(exist_ok=True)
        write_text(path, _text(motion, names, angles))
    if not path.is_file():
        pytest.skip(f"no result is kept for the backend {jax.default_backend()}; {RENEW}=1 writes {path.name}")
    kept = json.loads(path.read_text())
    assert kept["frames"] == motion.frames.tolist()
    assert kept["angle_names"] == names
    assert kept["joint_names"] == list(motion.joint_names)
    off = 1000 * np.linalg.norm(motion.joints - np.array(kept["joints_metres"]), axis=-1)
    turned = np.sqrt(np.mean((angles - np.array(kept["angles_degrees"])) ** 2))
    if off.mean() > MEAN_MM or turned > ROOT_MEAN_SQUARE_DEGREES:
        frame, joint = np.unravel_index(off.argmax(), off.shape)
        pytest.fail(
            f"{name} is not what it was: joints are {off.mean():.2f} mm off in the mean ({MEAN_MM:g} allowed), most "
            f"{motion.joint_names[joint]} in frame {motion.frames[frame]} ({off.max():.1f} mm), joint angles "
            f"{turned:.2f} degrees RMS ({ROOT_MEAN_SQUARE_DEGREES:g} allowed). If that is meant, say in CHANGELOG.md "
            f"which default changed and what it does to results, and write the file anew with {RENEW}=1; else mend it."
        )


def _text(motion: Motion, names: list[str], angles: np.ndarray) -> str:
    """A line per frame, so that changes can be read."""
    rows = lambda values: ",\n".join(json.dumps(row) for row in values.tolist())  # noqa: E731
    return (
        f'{{"frames": {json.dumps(motion.frames.tolist())},\n"angle_names": {json.dumps(names)},\n'
        f'"joint_names": {json.dumps(list(motion.joint_names))},\n"angles_degrees": [\n{rows(angles.round(3))}\n],\n'
        f'"joints_metres": [\n{rows(motion.joints.astype(float).round(5))}\n]}}\n'
    )
