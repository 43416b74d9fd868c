"""What a caller of the library gets wrong is said in one sentence, and not by JAX from deep inside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character

import jaxmocap as jm
from jaxmocap.appearance import AppearanceSettings, GridSettings
from jaxmocap.camera import Cameras, pixel_rays, project, triangulate
from jaxmocap.character import Pose, landmark_positions, rest_pose, retract, skin
from jaxmocap.energies import (
    GroupProblem,
    Posture,
    SearchEnergy,
    body_part,
    prepare_base,
    score_particles,
    search_energy,
)
from jaxmocap.experiments import story
from jaxmocap.render import face_ids
from jaxmocap.samplers import CrossEntropy, InteractingSimulatedAnnealing, run
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture

CHARACTER = box_character()
SKELETON, REST = CHARACTER.skeleton, rest_pose(CHARACTER.skeleton)
CAMERAS = Cameras(
    ("left", "right"),
    ((64, 48),) * 2,
    jnp.tile(jnp.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), (2, 1, 1)),
    jnp.zeros((2, 5)),
    jnp.tile(jnp.eye(4).at[2, 3].set(3.0), (2, 5, 1, 1)),
)
VIEW = CAMERAS.at(0)
THREE = jnp.zeros(3)


def refused(words: str):
    return pytest.raises(jm.InputError, match=words)


@pytest.mark.parametrize(
    ("words", "call"),
    {
        "pose of another skeleton": (
            r"pose.angles has the shape \(30,\); \(33,\) was expected: one per angle",
            lambda: skin(CHARACTER, Pose(REST.root, REST.angles[:30])),
        ),
        "several poses": (
            "several poses with jax.vmap",
            lambda: landmark_positions(SKELETON, Pose(REST.root[None], REST.angles[None])),
        ),
        "increment": (
            r"increment has the shape \(38,\); \(39,\) was expected",
            lambda: retract(SKELETON, REST, jnp.zeros(38)),
        ),
        "single point": (r"points has the shape \(3,\)", lambda: project(*_pinhole(), THREE)),
        "flat points": (r"points has the shape \(5, 2\)", lambda: project(*_pinhole(), jnp.zeros((5, 2)))),
        "all frames": ("of one frame", lambda: project(VIEW.intrinsics, CAMERAS.cam_from_world[..., :3, :], THREE)),
        "pixels of rays": (r"pixels has the shape \(4, 3\)", lambda: pixel_rays(*_pinhole(), jnp.zeros((4, 3)))),
        "pixels of cameras": (
            r"\(2, point, 2\) was expected: column and row in each of the 2",
            lambda: triangulate(VIEW, jnp.zeros((3, 5, 2)), jnp.ones((3, 5))),
        ),
        "weights": (r"weights has the shape \(5,\)", lambda: triangulate(VIEW, jnp.zeros((2, 5, 2)), jnp.ones(5))),
        "columns of faces": (
            "three vertex numbers a row",
            lambda: face_ids(CHARACTER.vertices, CHARACTER.faces.T, *_views(), np.zeros((2, 2), int), 8, 8),
        ),
        "origins": (
            r"origins has the shape \(2,\)",
            lambda: face_ids(CHARACTER.vertices, CHARACTER.faces, *_views(), np.zeros(2, int), 8, 8),
        ),
        "cameras of one name": (
            r"intrinsics of cameras has the shape \(2, 3, 3\); \(1, 3, 3\) was expected",
            lambda: Cameras(("left",), ((64, 48),), VIEW.intrinsics, jnp.zeros((1, 5)), CAMERAS.cam_from_world[:1]),
        ),
        "group": ("there is no group 'arm'; choose one of root, torso, l_arm", lambda: SKELETON.group("arm")),
        "landmark": ("there is no landmark 'wrist'; choose one of pelvis", lambda: SKELETON.landmark("wrist")),
        "story": ("there is no story 'fast'; choose one of arms-like-torso", lambda: story("fast")),
        "no terms": ("an energy without terms", lambda: SearchEnergy(())),
        "quality": ("quality 'best' is unknown", lambda: jm.appearance_preset("best")),
        "no particles": ("has 0 particles; at least 1", lambda: _run(sampler=CrossEntropy(num_particles=0))),
        "spread": (r"spread has the shape \(\); \(3,\) was expected", lambda: _run(spread=0.3)),
        "one energy": (
            r"what the energy returns has the shape \(\); \(8,\) was expected",
            lambda: _run(energy=lambda particles: jnp.sum(particles**2)),
        ),
        "seed for a key": (r"key is 0; give one key of JAX's, such as jax.random.key\(0\)", lambda: _run(key=0)),
        "several keys": ("key is .* of shape", lambda: _run(key=jax.random.split(jax.random.key(0)))),
        "float picture": (
            "type float32; uint8 was expected",
            lambda: _draw(np.zeros((48, 64, 3), np.float32)),
        ),
        "grey picture": (r"image has the shape \(48, 64\)", lambda: _draw(np.zeros((48, 64), np.uint8))),
    }.values(),
)
def test_arrays_that_do_not_fit_are_refused_in_a_sentence(words, call):
    with refused(words):
        call()


def _pinhole():
    return VIEW.intrinsics[0], VIEW.cam_from_world[0]


def _views():
    return VIEW.intrinsics, VIEW.cam_from_world


def _run(sampler=None, energy=lambda particles: jnp.sum(particles**2, -1), spread=None, key=None):
    sampler = CrossEntropy(num_particles=8, num_iterations=1) if sampler is None else sampler
    key = jax.random.key(0) if key is None else key
    spread = jnp.ones(3) if spread is None else spread
    return run(sampler, energy, THREE, spread, -jnp.ones(3), jnp.ones(3), key)


def _draw(image):
    return jm.draw_overlay(image, CHARACTER.vertices, CHARACTER.faces, *_pinhole())


@pytest.mark.parametrize("key", [jax.random.key(0), jax.random.PRNGKey(0)], ids=["new", "old"])
def test_keys_of_both_styles_will_do(key):
    assert np.all(np.isfinite(_run(InteractingSimulatedAnnealing(8, 1), key=key)[0]))


def test_a_frame_number_of_numpy_s_is_held_to_the_frames_there_are():
    np.testing.assert_array_equal(CAMERAS.at(np.int64(4)).cam_from_world, CAMERAS.cam_from_world[:, 4])
    with pytest.raises(IndexError, match=r"frame 5 is outside 0..4"):
        CAMERAS.at(np.int64(5))


@pytest.fixture(scope="module")
def shown() -> SyntheticCapture:
    return make_capture(2, (192, 108))


@pytest.fixture(scope="module")
def capture(shown, tmp_path_factory) -> jm.Capture:
    return jm.Capture.open(write_capture(shown, tmp_path_factory.mktemp("misuse") / "capture"))


def test_pictures_of_cameras_that_a_capture_does_not_have_are_refused(capture):
    for camera in (2, "cam0"):
        with pytest.raises(IndexError, match=r"is none of 0\.\.1"):
            capture.image(camera, 0)


def test_poses_and_cameras_that_are_not_the_capture_s_are_refused(capture, shown):
    key, pose = jax.random.key(0), shown.pose(0)
    learn = lambda cameras, poses, key=key: jm.fit_capture_appearance(capture, cameras, shown.character, poses, key=key)  # noqa: E731
    look = lambda cameras, poses: jm.observe(capture, cameras, shown.character, None, poses)  # noqa: E731
    for call in (learn, look):
        with refused("no pose of capture 'synthetic'"):
            call(shown.cameras, {})
        with refused("for frame 77, but capture 'synthetic' has frames 0 to 1"):
            call(shown.cameras, {0: pose, 77: pose})
        with refused("2 cameras and 2 frames, but the cameras given are 2 with 5"):
            call(CAMERAS, {0: pose})
    with refused("key is 3"):
        learn(shown.cameras, {0: pose}, 3)
    with refused("key is 3"):
        jm.register(capture, shown.cameras, shown.character, key=3)


def test_what_tracking_cannot_use_is_refused_before_it_begins():
    with refused("tracker is 'normal'; give a Tracker"):
        jm.track(None, tracker="normal")
    with refused("key is 0"):
        jm.track(None, key=0)
    with refused(r"frames is 3; give the first and the one after the last, such as \(0, 30\)"):
        jm.track(_Named(), frames=3)


class _Named:
    """Observations of a capture that has nothing but frames."""

    class capture:
        name, num_frames = "plaza", 9


@pytest.mark.slow
def test_no_particles_have_no_scores(capture, shown):
    poses = {frame: shown.pose(frame) for frame in shown.selected_frames}
    settings = AppearanceSettings(grid=GridSettings(rows=8, columns=8))
    made = (capture, shown.cameras, shown.character)
    appearance = jm.fit_capture_appearance(*made, poses, key=jax.random.key(0), settings=settings)
    frame = jm.observe(*made, appearance, poses).at(1, shown.pose(1))
    assert frame.number == 1
    assert frame.problem.size == (frame.rectangle.height, frame.rectangle.width)
    character = shown.character
    part = body_part(character, character.skeleton.group("l_arm"))
    group = GroupProblem(character, part, shown.pose(1), frame.problem)
    energy = SearchEnergy((*search_energy().terms, Posture()))
    base = prepare_base(energy, group, 4096)
    found = score_particles(energy, group, base, jnp.zeros((0, 39)), 4096)
    assert found.total.shape == (0,)
    assert found.terms.shape == (0, 3)
    with refused(r"increments has the shape \(2, 7\); \(particle, 39\) was expected"):
        score_particles(energy, group, base, jnp.zeros((2, 7)), 4096)
    with refused("left the image of camera|lies behind camera"):
        jm.observe(*made, appearance, poses).at(1, Pose(REST.root.at[0, 3].set(50.0), shown.pose(1).angles))
