"""A sequence that was cut off goes on to the same bits."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxmocap._cache import digest
from jaxmocap._results import InputError
from jaxmocap.appearance import AppearanceSettings
from jaxmocap.energies import search_energy
from jaxmocap.observation import Observations
from jaxmocap.track import Checkpoint, Tracker, _checkpoint, track, track_frames
from jaxmocap.track._checkpoint import Saved

KEY = jax.random.key(3)
INPUTS = {"seed": 3, "settings": "these"}
ENERGY = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")


class CutOff(Exception):
    """Stands for a kill after a frame."""


def tracker():
    """Everything that remembers something, with little effort, and the energy of the other tests of tracking."""
    normal = replace(Tracker.preset("normal"), search_energy=ENERGY)
    few = replace(normal.search.retry, tries=1)
    search = replace(normal.search, step=4, iterations=3, particles=24, retry=few)
    return replace(normal, search=search, refine=replace(normal.refine, rounds=1))


def observations(world):
    settings = AppearanceSettings(behind="plate")
    appearance = replace(world.appearance, settings=settings)
    return Observations(world.capture, world.cameras, world.character, appearance, world.key_poses)


def run(world, checkpoint=None, stop_after=None):
    def told(step):
        if step.done == stop_after:
            raise CutOff

    return track_frames(observations(world), tracker(), key=KEY, progress=told, checkpoint=checkpoint)


def content(results):
    return digest([replace(result, seconds={}) for result in results])


@pytest.fixture(scope="module")
def whole(world):
    return content(run(world))


@pytest.mark.slow
@pytest.mark.parametrize("stop_after", [1, 2])
def test_it_goes_on_to_the_same_bits(world, whole, tmp_path, stop_after):
    folder = tmp_path / "checkpoint"
    with pytest.raises(CutOff):
        run(world, Checkpoint(folder, INPUTS, share=np.inf), stop_after)
    assert Checkpoint(folder).exists
    told = []
    going_on = Checkpoint(folder, INPUTS)
    results = track_frames(
        observations(world), tracker(), key=KEY, progress=lambda step: told.append(step.done), checkpoint=going_on
    )
    assert content(results) == whole
    assert len(told) == 3 - stop_after, "frames that were done are not done again"
    going_on.remove()
    assert not folder.exists()


def test_frames_brought_into_another_light_are_found_again_in_it(world, tmp_path):
    """Images are decoded anew, not stored, and must be divided by the same factors."""
    known = observations(world)
    plain = next(known.frames(range(1, 2)))
    lit = plain.in_light(np.array([[1.2, 1.1, 0.9], [1.0, 1.0, 1.0]]))
    for shown in (plain, lit):
        frames = Checkpoint(tmp_path)._context(known)[1][0]
        again = frames.find(frames.note(shown))
        assert again.frame == 1
        for image, same in zip(again.images, shown.images, strict=True):
            np.testing.assert_array_equal(image, same)
    assert np.any(lit.images[0] != plain.images[0])


@pytest.mark.slow
def test_a_kill_while_it_is_written_leaves_the_one_before(world, whole, tmp_path, monkeypatch):
    folder = tmp_path / "checkpoint"
    with pytest.raises(CutOff):
        run(world, Checkpoint(folder, INPUTS), 1)
    before = sorted(path.name for path in folder.iterdir())

    def full(path, *_):
        if path.name == "state.npz":
            raise OSError(28, "No space left on device")
        path.write_bytes(b"half")

    with monkeypatch.context() as patch:
        patch.setattr(_checkpoint, "write_records", full)
        with pytest.raises(InputError, match=r"cannot be written \(No space left on device\); make room"):
            run(world, Checkpoint(folder, INPUTS))
    assert set(before) < {path.name for path in folder.iterdir()}
    assert content(run(world, Checkpoint(folder, INPUTS))) == whole


def test_other_inputs_and_damage_are_refused(world, tmp_path):
    folder = tmp_path / "out" / "checkpoint"
    with pytest.raises(CutOff):
        run(world, Checkpoint(folder, INPUTS), 1)
    with pytest.raises(InputError, match="begun with another seed;"):
        Checkpoint(folder, {**INPUTS, "seed": 4}).load(observations(world))
    state = folder / "state.npz"
    state.write_bytes(state.read_bytes()[:-100])
    with pytest.raises(InputError, match=r"out cannot be continued .* delete"):
        Checkpoint(folder, INPUTS).load(observations(world))


def test_nothing_is_kept_where_nothing_is_asked(world, tmp_path):
    assert Checkpoint(tmp_path / "none").load(observations(world)) is None


def test_writing_takes_little_of_the_time(tmp_path, monkeypatch):
    """A checkpoint that takes a second is due after the first frame, and again when fifty seconds have passed."""
    now, written = [1000.0], []
    monkeypatch.setattr(_checkpoint.time, "monotonic", lambda: now[0])
    checkpoint = Checkpoint(tmp_path)

    def save(saved, _observations):
        written.append(saved.frame)
        now[0] += 1.0

    monkeypatch.setattr(checkpoint, "save", save)
    for frame in range(6):
        checkpoint.keep(Saved({}, 0, frame, None, {}), None)
        now[0] += 20.0
    assert written == [0, 3]


def test_a_start_that_is_given_leaves_the_observations_as_they_were(world):
    """The start used to be written into the caller's key poses, so that the next call began there too. That the frames
    are neither searched nor refined changes nothing in it."""
    known, arm = observations(world), np.array(world.character.skeleton.group("l_arm")) - 6
    before, pose = digest(known.key_poses), world.pose(0)
    start = replace(pose, angles=pose.angles.at[arm].add(0.05))
    quick = Tracker(ENERGY, search=None, refine=None, flow_start=False)
    given, again, plain = (track(known, begin, quick, key=KEY, frames=(0, 2)) for begin in (start, start, None))
    assert digest(known.key_poses) == before
    assert given.angles.tobytes() == again.angles.tobytes()
    np.testing.assert_array_equal(given.angles[0], start.angles)
    np.testing.assert_array_equal(plain.angles[0], pose.angles)
