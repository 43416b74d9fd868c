"""The OpenSim model, its motion and its markers, as OpenSim itself reads and solves them."""

import importlib.util
import os
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._cli import run
from jaxmocap.character import Pose, angles_at_rest, build_skeleton, dominant_bodies, rest_pose
from jaxmocap.exporters import export
from jaxmocap.exporters._body_mass import body_mass
from jaxmocap.exporters._marker_set import marker_set
from jaxmocap.exporters._opensim_drive import shared_markers
from jaxmocap.exporters._prepare import neutral_angles
from jaxmocap.motion import Motion
from jaxmocap.synthetic import dance, make_actor

TRUNK = ("pelvis", "abdomen", "chest", "l_clavicle", "r_clavicle")
needs_opensim = pytest.mark.skipif(importlib.util.find_spec("opensim") is None, reason="opensim is not installed")


def columns_of(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a MOT, the time among them."""
    names, *rows = (line.split("\t") for line in path.read_text().split("endheader\n")[1].splitlines())
    return dict(zip(names, np.array(rows, float).T, strict=True))


@pytest.fixture(scope="module")
def danced() -> Motion:
    """An actor with a real outline, who rests in an A-pose with bent elbows."""
    character, times = make_actor(), np.arange(8) / 30
    return Motion.from_poses(character, dance(character.skeleton, times + 1.3), np.arange(8), times)


@pytest.fixture(scope="module")
def folder(danced, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("opensim")
    export(danced, folder / "dance.osim", mass=70)
    export(danced, folder / "dance.trc")
    return folder


@pytest.fixture(scope="module")
def read(folder) -> dict[str, np.ndarray]:
    """What OpenSim reads, in a process of its own: it leaves a log where it is started."""
    script = Path(__file__).with_name("read_in_opensim.py")
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([sys.executable, str(script), str(folder)], cwd=folder, env=own, capture_output=True)
    assert done.returncode == 0, done.stdout.decode()[-2000:] + done.stderr.decode()[-2000:]
    return dict(np.load(folder / "read.npz"))


@needs_opensim
def test_opensim_puts_every_joint_where_ours_is(danced, read):
    assert sorted(read["coordinates"]) == sorted(read["columns"])
    assert len(read["at"]) == len(danced)
    for number, name in enumerate(read["joint_names"]):
        joint = danced.joint_names.index("pelvis" if name == "ground_pelvis" else name)
        np.testing.assert_allclose(read["at"][:, number], danced.joints[:, joint], atol=1e-4)
    assert len(read["joint_names"]) == len(danced.character.skeleton.body_names)


@needs_opensim
def test_opensim_s_markers_are_those_of_the_trc_and_its_inverse_kinematics_comes_back(danced, read):
    markers = marker_set(danced.character)
    assert tuple(read["marker_names"]) == markers.names
    np.testing.assert_allclose(read["marked"], markers.along(danced), atol=1e-4)
    turned = ~np.isin(read["columns"], ["pelvis_tx", "pelvis_ty", "pelvis_tz"])
    off = (read["solved"] - read["values"])[:, turned]
    off -= 360 * np.round(off / 360)
    assert np.sqrt((off**2).mean()) < 0.01


@needs_opensim
@pytest.mark.parametrize("frames", [1, 5, 6])
def test_the_settings_run_as_they_are_however_short_the_clip(danced, frames, tmp_path):
    """OpenSim's splines through the known angles want six frames."""
    for suffix in (".osim", ".trc"):
        export(danced[:frames], tmp_path / f"dance{suffix}")
    script = (
        "import opensim; opensim.Logger.setLevelString('error'); "
        "assert opensim.InverseKinematicsTool('dance_ik.xml').run()"
    )
    own = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=own, capture_output=True)
    assert done.returncode == 0, done.stdout.decode()[-2000:] + done.stderr.decode()[-2000:]
    solved = columns_of(tmp_path / "dance_ik.mot")
    for name, values in columns_of(tmp_path / "dance.mot").items():
        np.testing.assert_allclose(solved[name], values, atol=0.1, err_msg=name)


@needs_opensim
def test_opensim_s_meshes_and_ranges_are_ours(danced, folder, read):
    skeleton = danced.character.skeleton
    for name, *limits in zip(skeleton.angle_names, skeleton.lower, skeleton.upper, strict=True):
        at_rest = (neutral_angles(danced) - danced.angles)[0, skeleton.angle_names.index(name)]
        given = read["ranges"][list(read["coordinates"]).index(name)]
        np.testing.assert_allclose(given, np.array(limits) + at_rest, atol=1e-5)
    assert read["masses"].sum() == pytest.approx(70, rel=1e-6)
    for body, name in enumerate(skeleton.body_names):
        used = np.unique(np.asarray(danced.character.faces)[dominant_bodies(danced.character) == body])
        if not len(used):
            continue
        lines = (folder / "dance_geometry" / f"{name}.obj").read_text().splitlines()
        own = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
        moved = read["bodies"][3, list(read["body_names"]).index(name)]
        ours = danced.body_transforms[3, body]
        np.testing.assert_allclose(
            own @ moved[:3, :3].T + moved[:3, 3],
            np.asarray(danced.character.vertices)[used] @ ours[:3, :3].T + ours[:3, 3],
            atol=1e-4,
        )


def test_masses_are_de_leva_s_and_every_body_resists_being_turned(danced):
    names, mass = danced.character.skeleton.body_names, body_mass(danced.character, 70.0)
    masses = dict(zip(names, mass.masses, strict=True))
    assert masses["l_thigh"] == pytest.approx(0.1447 * 70, rel=1e-3)
    assert sum(masses[name] for name in names if name in TRUNK) == pytest.approx(0.43 * 70, rel=1e-2)
    assert (np.linalg.eigvalsh(mass.inertias) > 0).all()
    thigh, at = names.index("l_thigh"), dict(zip(danced.joint_names, danced.character.skeleton.landmarks, strict=True))
    length = float(jnp.linalg.norm(at["l_knee"] - at["l_hip"]))
    across = masses["l_thigh"] * (0.347 * length) ** 2
    assert np.linalg.eigvalsh(mass.inertias[thigh])[1:] == pytest.approx([across, across], rel=1e-6)
    assert 40 < body_mass(danced.character).masses.sum() < 110


def test_markers_on_the_skin_lie_on_their_side_of_it(danced):
    """The inner marker of a knee is nearer to the other knee; the front of the pelvis is in front."""
    markers = marker_set(danced.character)
    at = dict(zip(markers.names, markers.places, strict=True))
    assert {"LASI", "RPSI", "C7", "CLAV", "LKNE", "RANK", "LFIN", "LHip", "RBigToe", "MidHip"} <= at.keys()
    for side, sign in (("L", 1), ("R", -1)):
        for outer, inner in (("KNE", "KNM"), ("ANK", "MED")):
            assert sign * (at[side + outer][0] - at[side + inner][0]) > 0.05
        assert at[f"{side}ASI"][2] - at[f"{side}PSI"][2] > 0.1
    vertices = np.asarray(danced.character.vertices)
    skin = [place for name, place in at.items() if name.upper() == name and not name.endswith("SHO")]
    assert max(np.linalg.norm(vertices - place, axis=1).min() for place in skin) < 0.05


def test_a_joint_that_opensim_cannot_hold_is_refused_and_nothing_is_left(danced, tmp_path):
    skeleton = danced.character.skeleton
    hip = skeleton.angle_names.index("l_hip_flex")
    parallel = skeleton.axes.at[hip + 1].set(skeleton.axes[hip])
    other = eqx.tree_at(lambda character: character.skeleton.axes, danced.character, parallel)
    with pytest.raises(ValueError, match="the joint l_hip turns about 3 axes, which an OpenSim joint cannot hold"):
        export(replace(danced, character=other), tmp_path / "dance.osim")
    assert not list(tmp_path.iterdir())


def test_a_model_and_all_that_is_in_it_have_names_that_opensim_takes(danced, tmp_path):
    skeleton, fields = danced.character.skeleton, ("body_names", "landmark_names", "dof_names")
    odd = {field: tuple(name.replace("r_", "r +/") for name in getattr(skeleton, field)) for field in fields}
    character = replace(danced.character, skeleton=replace(skeleton, **odd))
    path = export(replace(danced, character=character), tmp_path / "my dance*2.osim")
    model = ElementTree.parse(path)
    names = {tag: [one.get("name") for one in model.iter(tag)] for tag in ("Model", "Body", "Coordinate", "Marker")}
    assert names["Model"] == ["my_dance_2"]
    assert {"r___thigh"} <= set(names["Body"])
    assert {"RHip"} <= set(names["Marker"])
    assert not [name for one in model.iter() if (name := one.get("name")) and set(name) & set("\\*+/ \t\n")]
    frames = {one.text for one in model.iter() if (one.text or "").startswith("/bodyset/")}
    assert frames == {f"/bodyset/{name}" for name in names["Body"]}
    columns = path.with_suffix(".mot").read_text().split("endheader\n")[1].split("\n")[0].split("\t")
    assert columns == ["time", *names["Coordinate"]]
    for mesh in model.iter("mesh_file"):
        assert (tmp_path / mesh.text).is_file()


def test_what_lies_beside_a_model_is_never_overwritten(danced, tmp_path):
    (tmp_path / "dance.mot").write_text("mine")
    with pytest.raises(ValueError, match=r"dance.mot exists already"):
        export(danced, tmp_path / "dance.osim")
    with pytest.raises(ValueError, match="the mass is 0; expected the person's in kilograms"):
        export(danced, tmp_path / "other.osim", mass=0)
    assert [path.name for path in tmp_path.iterdir()] == ["dance.mot"]


def test_a_body_that_does_not_turn_is_welded_to_its_parent(danced, tmp_path):
    """Arms with a wrist instead of a collar bone."""
    character = danced.character
    places = dict(zip(danced.joint_names, np.asarray(character.skeleton.landmarks), strict=True))
    character = replace(character, skeleton=build_skeleton(places, "wrist7"))
    poses = jax.tree.map(lambda leaf: leaf[None], rest_pose(character.skeleton))
    path = export(Motion.from_poses(character, poses, [0], [0.0]), tmp_path / "dance.osim")
    joints = ElementTree.parse(path).iter("WeldJoint")
    assert [joint.get("name") for joint in joints] == ["l_clavicle", "r_clavicle"]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory) -> Path:
    """Somebody else's model: a shorter body than the dancer's, standing, whose markers have names of their own."""
    character = make_actor(1.55)
    skeleton = character.skeleton
    angles = -angles_at_rest(skeleton)
    for side in "lr":
        angles[skeleton.angle_names.index(f"{side}_shoulder_abd")] -= np.radians(80)
    pose = Pose(jnp.eye(4)[None], jnp.asarray(angles[None], jnp.float32))
    path = tmp_path_factory.mktemp("foreign") / "theirs.osim"
    export(Motion.from_poses(character, pose, [0], [0.0]), path)
    text = path.read_text()
    for ours, theirs in {"LKNE": "LLFC", "RKNE": "RLFC", "RSHO": "R.Acromium", "LASI": "L.ASIS_study"}.items():
        text = text.replace(f'Marker name="{ours}"', f'Marker name="{theirs}"')
    path.write_text(text)
    return path


@needs_opensim
def test_somebody_else_s_model_is_scaled_to_the_person_and_moves_as_they_do(danced, foreign, folder, tmp_path):
    """It is this person's but for its size, so that it must fit."""
    said = []
    export(danced, tmp_path / "driven.osim", mass=70, opensim_model=[foreign], say=said.append)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["driven.mot", "driven.osim"]
    off = float(said[0].split("off by ")[1].split(" cm")[0])
    assert off < 0.3
    tables = [columns_of(path) for path in (tmp_path / "driven.mot", folder / "dance.mot")]
    for name in ("l_knee_flex", "r_knee_flex", "l_hip_abd", "r_elbow_flex", "neck_axial", "pelvis_list"):
        assert np.sqrt(np.mean((tables[0][name] - tables[1][name]) ** 2)) < 1.0, name
    driven, ours = (ElementTree.parse(path) for path in (tmp_path / "driven.osim", folder / "dance.osim"))
    assert sum(float(mass.text) for mass in driven.iter("mass")) == pytest.approx(70, rel=1e-3)
    for name in ("l_knee", "r_ankle", "l_elbow", "r_wrist", "neck", "thorax", "l_hip"):
        lengths = []
        for document in (driven, ours):
            (joint,) = (one for one in document.iter("CustomJoint") if one.get("name") == name)
            lengths.append(np.linalg.norm(np.array(next(joint.iter("translation")).text.split(), float)))
        assert lengths[0] == pytest.approx(lengths[1], rel=0.02), name


def test_the_markers_of_other_models_are_known_by_their_names(danced, foreign):
    names = shared_markers((foreign,), danced.character)
    assert (names["LLFC"], names["R.Acromium"], names["L.ASIS_study"]) == ("LKNE", "RSHO", "LASI")
    assert len(names) == len(marker_set(danced.character).names)


@needs_opensim
def test_a_model_that_cannot_be_driven_is_one_sentence(danced, foreign, tmp_path, capsys):
    result = danced.save(tmp_path / "result")
    (tmp_path / "few.osim").write_text('<OpenSimDocument><Marker name="RASI"/><Marker name="x"/></OpenSimDocument>')
    (tmp_path / "text.osim").write_text("no model")
    for arguments, words in (
        (["a.osim", "--opensim-model", "nowhere.osim"], "nowhere.osim cannot be read (No such file or directory)"),
        (["a.osim", "--opensim-model", str(tmp_path / "text.osim")], "is no file of OpenSim's"),
        (["a.osim", "--opensim-model", str(tmp_path / "few.osim")], "has 1 markers that we know (RASI); at least 8"),
        (["a.trc", "--opensim-model", str(foreign)], "--opensim-model is for .osim, which --to does not name"),
    ):
        arguments[0] = str(tmp_path / arguments[0])
        assert run(["export", str(result), "--to", *arguments]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert words in err
    assert not list(tmp_path.glob("a.*"))
