"""A skeleton that is not a person's, a trunk with one arm, goes through everything: search, refinement, scores, files.

It stands in a world of which everything is known: every body has a colour of its own, and so has the background.
"""

import csv
import sys
from dataclasses import replace
from pathlib import Path

import bvhsdk
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import (
    ROOT_DOFS,
    Character,
    Pose,
    SkeletonTable,
    build_skeleton,
    clamp,
    difference,
    dominant_bodies,
    human_table,
    pose_from_vector,
    retract,
    skeleton_of,
    skin,
)
from jaxmocap.energies import ContourSettings, ModelView, Posture, SearchEnergy, contour_lines
from jaxmocap.exporters import export
from jaxmocap.motion import Motion
from jaxmocap.observation import build_problem, draw, frame_rectangle, surface_of
from jaxmocap.refinement import Rows, descend, free_prior
from jaxmocap.refiners import Shooting
from jaxmocap.samplers import InteractingSimulatedAnnealing
from jaxmocap.search import PoseScore, group_searches
from jaxmocap.viewers._report_record import report_record

sys.path.append(str(Path(__file__).parents[1] / "exporters"))
from posed_glb import PosedGlb

PLACES = {
    "pelvis": (0.0, 0.9, 0.0), "spine": (0.0, 1.0, 0.0), "thorax": (0.0, 1.2, 0.0), "neck": (0.0, 1.5, 0.0),
    "l_clavicle": (0.04, 1.42, 0.0), "l_shoulder": (0.2, 1.42, 0.0), "l_elbow": (0.5, 1.42, 0.0),
    "l_wrist": (0.78, 1.42, 0.0),
}  # fmt: skip
ENDS = {"head": (0.0, 1.75, 0.03), "l_hand": (0.95, 1.42, 0.0)}
WIDTHS = {"pelvis": 0.15, "abdomen": 0.14, "chest": 0.16, "head": 0.09}
TURNS = {"hinge_0": 0.2, "hinge_2": -0.3, "l_hinge_8": 0.2, "l_hinge_10": -0.5, "l_hinge_12": 0.9}
SIZE = (320, 240)


def table() -> SkeletonTable:
    """Trunk and left arm of a person, every degree of freedom under a name that says nothing."""
    whole = human_table()
    bodies = tuple(body for body in whole.bodies if body[2] in PLACES)
    names = {body for body, _, _ in bodies}
    dofs = [dof for dof in whole.dofs if dof.body in names]
    dofs = [dof._replace(name=f"{'l_' * (dof.group == 'l_arm')}hinge_{n}") for n, dof in enumerate(dofs)]
    return SkeletonTable(bodies, tuple(dofs), tuple((joint, body) for body, _, joint in bodies))


def box(start: np.ndarray, end: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed box along a bone, its long sides cut in four."""
    along, rings = (end - start) / np.linalg.norm(end - start), []
    side = np.cross(along, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    for share in np.linspace(0.02, 0.98, 5):
        for a, b in ((-1, -0.7), (1, -0.7), (1, 0.7), (-1, 0.7)):
            rings.append(start + share * (end - start) + width * (a * side + b * np.cross(side, along)))
    faces = [[0, 1, 2], [0, 2, 3], [16, 18, 17], [16, 19, 18]]
    for ring in range(0, 16, 4):
        for k in range(4):
            a, b = ring + k, ring + (k + 1) % 4
            faces += [[a, a + 4, b + 4], [a, b + 4, b]]
    return np.array(rings), np.array(faces)


@pytest.fixture(scope="module")
def character() -> Character:
    """A box per body."""
    skeleton = skeleton_of(table(), {name: np.array(place) for name, place in PLACES.items()})
    vertices, faces, weights = [], [], []
    for number, (body, joint) in enumerate(zip(skeleton.body_names, skeleton.joint_names, strict=True)):
        after = {"abdomen": "thorax", "pelvis": "spine", "chest": "neck", "l_clavicle": "l_shoulder"}
        after |= {"l_upper_arm": "l_elbow", "l_forearm": "l_wrist"}
        end = ENDS[body] if body in ENDS else PLACES[after[body]]
        corners, triangles = box(np.array(PLACES[joint]), np.array(end), WIDTHS.get(body, 0.045))
        faces.append(triangles + 20 * number)
        vertices.append(corners)
        weights.append(np.tile(np.eye(len(skeleton.body_names))[number], (20, 1)))
    return Character(
        "one arm",
        skeleton,
        jnp.asarray(np.concatenate(vertices), jnp.float32),
        jnp.asarray(np.concatenate(faces), jnp.int32),
        jnp.asarray(np.concatenate(weights), jnp.float32),
    )


@pytest.fixture(scope="module")
def cameras() -> Cameras:
    """Three views around it."""
    poses = []
    for angle in np.radians((-50.0, 10.0, 60.0)):
        forward = -np.array([np.sin(angle), 0.0, np.cos(angle)])
        rotation = np.stack([np.cross([0.0, -1.0, 0.0], forward), [0.0, -1.0, 0.0], forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ (np.array([0.2, 1.3, 0.0]) - 2.5 * forward)
        poses.append(pose)
    k = np.array([[300.0, 0, SIZE[0] / 2], [0, 300.0, SIZE[1] / 2], [0, 0, 1]])
    names = ("left", "front", "right")
    return Cameras(
        names, (SIZE,) * 3, *(jnp.asarray(v, jnp.float32) for v in (np.tile(k, (3, 1, 1)), np.zeros((3, 5)))),
        jnp.asarray(np.array(poses)[:, None], jnp.float32),
    )  # fmt: skip


def pose_of(character: Character, turns: dict[str, float]) -> Pose:
    names = character.skeleton.dof_names
    vector = np.array([turns.get(name, 0.0) for name in names], np.float32)
    return pose_from_vector(character.skeleton, jnp.asarray(vector))


@pytest.fixture(scope="module")
def truth(character) -> Pose:
    return pose_of(character, TURNS)


@pytest.fixture(scope="module")
def problem(character, cameras, truth):
    """The frame at the truth: pixels have the colour of their body, and each face is like its own body's colour."""
    vertices, bodies = np.asarray(skin(character, truth)), dominant_bodies(character)
    colours = np.arange(len(character.skeleton.body_names) + 1)
    rectangle = frame_rectangle(vertices, cameras, 0)
    like = jnp.asarray(bodies[:, None] != colours, jnp.float16)
    surface = replace(surface_of(character, None, 3), colour_distance=jnp.tile(like, (3, 1, 1)))
    blank = [np.zeros((SIZE[1], SIZE[0], 3), np.uint8)] * 3
    empty = build_problem(blank, rectangle, cameras, 0, vertices, surface)
    ids = np.asarray(draw(character, truth, empty)[1])
    labels = np.where(ids >= 0, bodies[ids], len(colours) - 1)
    masks = [np.float32(view >= 0) for view in ids]
    images = [np.full((SIZE[1], SIZE[0], 3), 25 * len(colours), np.uint8) for _ in masks]
    for image, label, (row, column) in zip(images, labels, rectangle.origins, strict=True):
        image[row : row + rectangle.height, column : column + rectangle.width] = 25 * (label[..., None] + 1)
    return build_problem(images, rectangle, cameras, 0, vertices, surface, list(labels), masks)


ENERGY = SearchEnergy((ModelView(), Posture(1e-4)))


@pytest.fixture(scope="module")
def found(character, problem, truth):
    """The start, and what search and refinement make of it."""
    skeleton = character.skeleton
    signs = np.random.default_rng(0).choice([-1.0, 1.0], skeleton.num_dofs)
    start = clamp(skeleton, retract(skeleton, truth, jnp.asarray(signs * skeleton.per_dof(0.03, 0.12), jnp.float32)))
    pose = start
    for number, search in enumerate(group_searches(character, ENERGY, step=2)):
        sampler = InteractingSimulatedAnnealing(num_particles=160, num_iterations=14, answer="best_if_better")
        key = jax.random.key(number)
        result = search(sampler, pose, problem, skeleton.initial_spread, key)
        pose = retract(skeleton, pose, result.increment)
    searched = pose
    for _ in range(4):
        vertices, ids, inverse = draw(character, pose, problem)
        lines = contour_lines(vertices, character.faces, ids, inverse, problem, ContourSettings(step=1))
        prior = free_prior(character, pose, skeleton.per_dof(root=0.01, angles=0.3))
        delta = difference(skeleton, pose, pose)
        delta, hessian = descend(character, pose, delta, (Rows(lines, 0.02, 0.02),), (), prior, Shooting())
        pose = retract(skeleton, pose, delta)
        assert hessian.shape == (skeleton.num_dofs,) * 2
    return start, searched, pose


def test_the_numbers_are_the_skeleton_s_own(character):
    skeleton = character.skeleton
    assert (skeleton.num_dofs, skeleton.num_angles) == (ROOT_DOFS + 14, 14)
    assert skeleton.limbs == ("l_arm",)
    assert skeleton.limb_labels == {"l_arm": "left arm"}
    names = np.array(skeleton.body_names)
    assert names[skeleton.bodies_of("l_arm")].tolist() == ["l_clavicle", "l_upper_arm", "l_forearm", "l_hand"]
    assert [names[beyond].tolist() for beyond in skeleton.distal_bodies] == [["l_forearm", "l_hand"]]
    assert skeleton.initial_spread.shape == (skeleton.num_dofs,)
    assert skeleton.axes.shape == (14, 3)


@pytest.mark.parametrize("arm", ["cmu7", "wrist7"])
def test_the_distal_bodies_of_a_person_are_those_beyond_elbows_and_knees(arm):
    places = PLACES | {"r_shoulder": (-0.2, 1.42, 0.0), "r_elbow": (-0.5, 1.42, 0.0), "r_wrist": (-0.78, 1.42, 0.0)}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for joint, height in (("hip", 0.88), ("knee", 0.5), ("ankle", 0.1)):
            places[f"{side}_{joint}"] = (0.1 * sign, height, 0.0)
    places = {name: np.array(place) for name, place in places.items() if "clavicle" not in name}
    skeleton = build_skeleton(places, arm)
    names = np.array(skeleton.body_names)
    beyond = {limb: set(names[bodies]) for limb, bodies in zip(skeleton.limbs, skeleton.distal_bodies, strict=True)}
    arms = {f"{side}_arm": {f"{side}_forearm", f"{side}_hand"} for side in "lr"}
    assert beyond == arms | {f"{side}_leg": {f"{side}_shank", f"{side}_foot"} for side in "lr"}
    assert skeleton.kind("l_leg") == skeleton.kind("r_leg") == "leg"


@pytest.mark.slow
def test_search_and_refinement_find_the_pose(character, truth, found):
    off = [
        float(np.linalg.norm(np.asarray(skin(character, pose)) - np.asarray(skin(character, truth)), axis=1).mean())
        for pose in found
    ]
    assert off[0] > 0.06
    assert off[1] < 0.5 * off[0]
    assert off[2] < 0.6 * off[1]


@pytest.mark.slow
def test_the_score_is_least_at_the_truth(character, problem, truth, found):
    score = PoseScore(ENERGY, character)
    totals, terms = score(problem, [*found, truth])
    assert terms.shape == (4, 2)
    assert np.all(np.diff(totals) < 1e-6)


@pytest.fixture(scope="module")
def motion(character) -> Motion:
    poses = [pose_of(character, {name: share * turn for name, turn in TURNS.items()}) for share in (0.0, 0.5, 1.0)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *poses)
    return Motion.from_poses(character, stacked, range(3), np.arange(3) / 30)


def test_bvh_has_a_joint_per_body_where_it_is(motion, tmp_path):
    read = bvhsdk.ReadFile(str(export(motion, tmp_path / "arm.bvh", units="m")))
    joints = {joint.name: joint for joint in read.getlistofjoints()}
    skeleton = motion.character.skeleton
    for body, joint in zip(skeleton.body_names, skeleton.joint_names, strict=True):
        place = motion.joints[2, motion.joint_names.index(joint)]
        np.testing.assert_allclose(np.asarray(joints[body].getPosition(2)), place, atol=1e-4)


def test_glb_is_the_skinned_mesh(motion, tmp_path):
    posed = PosedGlb(export(motion, tmp_path / "arm.glb")).at(2 / 30)
    np.testing.assert_allclose(posed.vertices, motion.vertices(2), atol=1e-4)


def test_csv_has_a_column_per_angle(motion, tmp_path):
    rows = list(csv.DictReader(export(motion, tmp_path / "arm.csv").open()))
    for name, turn in TURNS.items():
        assert float(rows[2][f"{name}_deg"]) == pytest.approx(np.degrees(turn), abs=1e-3)
    assert sum(name.endswith("_deg") for name in rows[0]) == 3 + motion.character.skeleton.num_angles


@pytest.mark.parametrize("suffix", [".usda", ".trc", ".mot", ".osim", ".c3d"])
def test_the_other_formats_take_it_too(motion, tmp_path, suffix):
    assert export(motion, tmp_path / f"arm{suffix}").stat().st_size > 0


@pytest.fixture(scope="module")
def strange(motion) -> Motion:
    """The same, and no name is one of a person's."""
    skeleton = motion.character.skeleton
    names = {field: tuple(f"part {n}" for n in range(8)) for field in ("body_names", "landmark_names")}
    return replace(motion, character=replace(motion.character, skeleton=replace(skeleton, **names)))


def test_the_root_is_the_first_body_whatever_it_is_called(motion, strange, tmp_path):
    tables = []
    for name, one in (("arm", motion), ("strange", strange)):
        assert export(one, tmp_path / f"{name}.osim").exists()
        text = export(one, tmp_path / "finer" / f"{name}.mot", frame_rate=60).read_text()
        tables.append(np.array([line.split() for line in text.split("endheader\n")[1].splitlines()[1:]], float))
    assert len(tables[0]) == 5
    np.testing.assert_allclose(tables[1][:, :7], tables[0][:, :7], atol=1e-5)


def test_isb_angles_of_none_of_a_person_s_joints_are_refused(strange, tmp_path):
    for suffix in (".isb.csv", ".isb.mot"):
        with pytest.raises(InputError, match=r"one arm has none of a person's joints .*\(its joints are part 0, "):
            export(strange, tmp_path / f"arm{suffix}")
    assert not list(tmp_path.iterdir())


def test_the_report_plots_the_landmarks_there_are(motion):
    deviations = np.broadcast_to(1e-4 * np.eye(3, dtype=np.float32), (*motion.joints.shape, 3))
    record = report_record(replace(motion, covariance=deviations), {})
    assert set(record["uncertainty"]) == {"median over joints", "l_wrist"}
    assert "l_elbow" in record["confidence"]["names"]


def test_a_result_folder_gives_the_skeleton_back(motion, tmp_path):
    loaded = Motion.load(motion.save(tmp_path / "result"))
    assert jax.tree.structure(loaded.character) == jax.tree.structure(motion.character)
    np.testing.assert_array_equal(loaded.character.skeleton.initial_spread, motion.character.skeleton.initial_spread)
