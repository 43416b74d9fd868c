"""What tells a right answer from a wrong one, and which frames are not trusted in the end."""

from dataclasses import replace
from itertools import permutations

import jax
import numpy as np
import pytest
from perturbed import arm_away, moved

from jaxmocap._cli._track import NOT_TRUSTED, counted, report_trust
from jaxmocap.energies import Posture, SearchEnergy
from jaxmocap.refinement import FlowSettings
from jaxmocap.search import Evidence
from jaxmocap.track import FrameTracker, Tracker
from jaxmocap.track._sequence import motion_of
from jaxmocap.verdict import FrameSignals, VerdictSettings, doubts, frame_signals, outlier_cameras
from jaxmocap.verdict._doubts import ALONE, APART, FAST, OUTLINE, REGISTERED, UNEXPLAINED, UNTOLD
from jaxmocap.verdict._features import FRAME_FEATURES, frame_features
from jaxmocap.verdict._outlier_camera import contradicted
from jaxmocap.verdict._sequence_verdict import _trust

FRAME = 1
SETTINGS = VerdictSettings(steady=3)
FAR, FOREIGN = 0.05, 1.5
"""Metres between what two views show, and a share of the body, that no right frame has."""


@pytest.fixture(scope="module")
def true_result(world):
    """Of a tracker whose energy, that of the posture, compiles soon: no doubt looks at it."""
    plain = Tracker(SearchEnergy((Posture(),)), search=None, refine=None)
    tracker = FrameTracker(world.observations(), plain, jax.random.key(0))
    return tracker.first(world.shown(FRAME), world.pose(FRAME)).result


def signals(world, pose, shown=None) -> FrameSignals:
    evidence, frame = Evidence.of(world.character), world.frame(FRAME, shown)
    return frame_signals(evidence, frame, evidence.draw(pose, frame.problem), FlowSettings())


def test_at_the_truth_both_views_show_the_same(world):
    found = signals(world, world.pose(FRAME))
    assert found.view_gaps.shape == found.matched.shape == (2,)
    assert found.view_gaps.max() < 0.005
    assert found.matched.min() > 0.4
    assert max(found.bare.max(), found.uncovered.max()) < 0.06
    assert np.nanmax(found.limb_gaps) < 0.01


def test_the_gap_between_views_grows_with_the_distance_from_the_truth(world):
    """Two views 27 degrees apart: a body that is d aside in depth is off by a part of d in what they share."""
    gaps = [signals(world, moved(world, FRAME, root_tz=metres)).view_gaps.max() for metres in (0.0, 0.02, 0.04)]
    assert gaps[0] < 0.5 * gaps[1] < gaps[1] < gaps[2]


def test_somebody_beside_the_person_is_left_out_and_a_piece_of_the_person_is_not(world):
    pose, evidence, frame = world.pose(FRAME), Evidence.of(world.character), world.frame(FRAME)
    drawn = evidence.draw(pose, frame.problem)
    row, column = np.nonzero(drawn.ids[0] >= 0)
    margin = max(0.1 * max(np.ptp(row), np.ptp(column)), 20)

    def uncovered(first):
        background = np.array(frame.problem.background)
        background[0, row.min() + 10 : row.max() - 10, first : first + 30] = 1.0
        shown = frame._replace(problem=replace(frame.problem, background=background))
        return frame_signals(evidence, shown, drawn, FlowSettings()).uncovered[0]

    away = [uncovered(first) for first in (column.max() + 3, column.max() + int(margin) + 2)]
    assert away[0] > 0.2
    assert away[1] < 0.06


def test_pictures_of_different_bodies_are_not_matched(world):
    """The second camera shows its picture upside down: nothing on the body is the same."""
    shown, right = world.shown(FRAME), signals(world, world.pose(FRAME))
    rectangle = world.rectangle(FRAME)
    turned = shown.images[1].copy()
    window = rectangle.window(1)
    turned[window] = turned[window][::-1, ::-1]
    wrong = signals(world, world.pose(FRAME), shown._replace(images=[shown.images[0], turned]))
    assert wrong.matched.max() < 0.5 * right.matched.min()


def test_a_body_beside_the_person_covers_background(world):
    right, wrong = signals(world, world.pose(FRAME)), signals(world, moved(world, FRAME, root_tx=0.3))
    assert right.bare.max() < 0.06 < 0.2 < wrong.bare.max()
    assert right.uncovered.max() < 0.06 < 0.2 < wrong.uncovered.max()
    arm = signals(world, arm_away(world, FRAME))
    assert right.bare.max() < arm.bare.max() < wrong.bare.max()


def frames(result, count, **changed):
    """Many frames like one, with signals changed in some: name -> {frame: value}."""
    made = []
    for frame in range(count):
        values = {name: at[frame] for name, at in changed.items() if frame in at}
        status = values.pop("status", "ok")
        found = {name: np.full_like(getattr(result.signals, name), value) for name, value in values.items()}
        signals = replace(result.signals, **found)
        made.append(replace(result, frame=frame, status=status, signals=signals))
    return made


def trusted(results, found):
    """Status and confidence of every frame once these doubts are known."""
    return [_trust(result, found, SETTINGS) for result in results]


def doubted(results, **known):
    features = frame_features(results, ~contradicted(results, SETTINGS), SETTINGS)
    return doubts(results, features, SETTINGS, **known)


def told(results, **known):
    return [(doubt.first, doubt.last, doubt.why) for doubt in doubted(results, **known)]


def test_right_frames_are_trusted(true_result):
    assert told(frames(true_result, 6)) == []


def test_every_reason_has_its_frames_and_every_frame_one_reason(true_result):
    results = frames(
        true_result,
        30,
        view_gaps=dict.fromkeys(range(4, 8), FAR),
        bare=dict.fromkeys(range(12, 15), FOREIGN),
        costs=dict.fromkeys((20, 21), 0.9),
        status={25: "doubtful"},
    )
    assert told(results) == [(4, 7, APART), (12, 14, OUTLINE), (20, 21, UNEXPLAINED), (25, 25, FAST)]
    both = frames(true_result, 9, view_gaps=dict.fromkeys(range(4, 8), FAR), costs=dict.fromkeys(range(4, 7), 0.4))
    assert told(both) == [(4, 7, APART)]


def test_one_frame_of_many_is_chance(true_result):
    assert told(frames(true_result, 9, view_gaps={4: FAR})) == []
    assert told(frames(true_result, 20, view_gaps=dict.fromkeys((4, 6), FAR))) == [(5, 5, APART)]


def views(result, apart, cameras=3, status="ok", unknown=(), **changed):
    """Frames that several cameras show: those in `apart` show the body elsewhere than all others, which agree unless
    they are of different `apart`; what is `unknown` is seen with no other. Signals per camera are given by name."""
    side = {camera: number for number, group in enumerate(apart, 1) for camera in group}
    pairs = list(permutations(range(cameras), 2))
    gaps = [0.0 if side.get(m, 0) == side.get(n, 0) else FAR for m, n in pairs]
    matched = [np.nan if m in unknown or n in unknown else 1.0 for m, n in pairs]
    each = {name: np.array(changed.get(name, [0.0] * cameras)) for name in ("costs", "bare", "uncovered")}
    signals = replace(
        result.signals, **each, view_gaps=np.array(gaps), matched=np.array(matched), speed=changed.get("speed", 0.0)
    )
    return [replace(result, frame=frame, signals=signals, status=status) for frame in range(5)]


def odd(results):
    return [(one.camera, one.first, one.last) for one in outlier_cameras(results, SETTINGS, "abcd")]


@pytest.mark.parametrize("camera", [0, 1, 2])
def test_a_camera_that_two_others_contradict_has_no_say(true_result, camera):
    costs, uncovered = np.eye(3)[camera], 0.9 * np.eye(3)[camera]
    results = views(true_result, [[camera]], costs=costs, uncovered=uncovered, bare=uncovered)
    assert told(results) == []
    assert odd(results) == [("abc"[camera], 0, 4)]
    assert [status for status, _ in trusted(results, doubted(results))] == ["ok"] * 5


def test_where_no_views_can_be_compared_that_is_the_reason_of_what_doubt_there_is(true_result):
    clear, unclear = (views(true_result, [], 2, unknown=(0, 1), uncovered=[share, share]) for share in (0.0, 0.1))
    far = [
        [replace(r, signals=replace(r.signals, view_gaps=np.full(2, np.nan))) for r in of] for of in (clear, unclear)
    ]
    assert told(far[0]) == []
    assert told(far[1]) == [(0, 4, ALONE)]
    assert [status for status, _ in trusted(far[1], doubted(far[1]))] == ["doubtful"] * 5
    np.testing.assert_array_equal(trusted(far[1], doubted(far[1]))[0][1], far[1][0].confidence)


def test_wide_apart_is_not_the_same_as_a_single_camera(true_result):
    """Neither can be compared; a camera that shows nothing of the body has costs of 1 and covers nothing."""
    unknown = {"view_gaps": np.full(2, np.nan)}
    found = []
    for costs in (np.zeros(2), np.array([0.1, 1.0])):
        signals = replace(true_result.signals, costs=costs, **unknown)
        results = [replace(true_result, frame=frame, signals=signals) for frame in range(3)]
        features = frame_features(results, np.ones((3, 2), bool), SETTINGS)
        found.append([features[0, FRAME_FEATURES.index(name)] for name in ("alone", "wide apart")])
    assert found == [[0, 1], [1, 0]]


def test_a_frame_passed_over_in_a_film_of_right_frames_is_as_likely_wrong_as_they_are(true_result):
    results = [replace(true_result, frame=frame) for frame in range(5)]
    results[2] = replace(results[2], energy={}, signals=None)
    features = frame_features(results, np.ones((5, 2), bool), SETTINGS)
    np.testing.assert_allclose(features, np.broadcast_to(features[0], features.shape))
    nothing = [replace(result, energy={}, signals=None) for result in results]
    assert frame_features(nothing, np.ones((5, 2), bool), SETTINGS).shape == features.shape


def test_what_the_other_cameras_say_still_counts(true_result):
    for changed, reason in (({"uncovered": [0, 0, 3.0]}, OUTLINE), ({"costs": [0, 0, 1.9]}, UNEXPLAINED)):
        assert told(views(true_result, [[1]], **changed)) == [(0, 4, reason)]
    assert told(views(true_result, [[1]], status="doubtful", speed=99.0)) == [(0, 4, FAST)]


def test_no_camera_is_odd_where_none_agree_or_as_many_do_on_either_side(true_result):
    for apart, cameras in (([[0], [1]], 3), ([[1]], 2), ([[0, 1]], 4)):
        results = views(true_result, apart, cameras)
        assert odd(results) == []
        assert told(results) == [(0, 4, APART)]


def test_a_camera_too_far_from_all_others_counts(true_result):
    results = views(true_result, [], uncovered=[0, 0, 3.0], unknown=[2])
    assert odd(results) == []
    assert told(results) == [(0, 4, OUTLINE)]


def test_a_frame_that_was_not_looked_at_between_frames_with_an_outlier_camera_stays_doubtful(true_result):
    results = views(true_result, [[1]])
    results[2] = replace(results[2], energy={}, signals=None, status="doubtful")
    assert [status for status, _ in trusted(results, doubted(results))] == ["ok", "ok", "doubtful", "ok", "ok"]


def test_two_cameras_always_count(true_result):
    """Of five cameras others agree in every frame; each is alone in three of five frames."""
    results = [views(true_result, [[c] for c in range(5) if c not in (f, (f + 1) % 5)], 5)[f] for f in (0, 2, 4, 1, 3)]
    results = [replace(result, frame=frame) for frame, result in enumerate(results)]
    inlier = ~contradicted(results, SETTINGS)
    assert (inlier.sum(1) >= 2).all()
    assert np.isfinite(frame_features(results, inlier, SETTINGS)).all()


def test_a_camera_that_is_odd_for_a_frame_is_chance(true_result):
    right, wrong = views(true_result, []), views(true_result, [[1]])
    assert odd([*right[:2], wrong[2], *right[3:]]) == []
    assert odd([*wrong[:2], right[2], *wrong[3:]]) == [("b", 0, 4)]


def test_background_covered_and_person_uncovered_count_alike_and_as_the_mean_over_views(true_result):
    signals = replace(true_result.signals, bare=np.array([0.8, 0.0]), uncovered=np.array([0.0, 1.0]))
    for factor, expected in ((0.05, []), (1.5, [(0, 2, OUTLINE)])):
        some = replace(signals, bare=factor * signals.bare, uncovered=factor * signals.uncovered)
        results = [replace(true_result, frame=frame, signals=some) for frame in range(3)]
        features = frame_features(results, np.ones((3, 2), bool), SETTINGS)
        np.testing.assert_allclose(features[:, FRAME_FEATURES.index("outline")], np.sqrt(0.9 * factor))
        assert told(results) == expected


def test_frames_passed_over_do_not_say_that_little_is_known_of_their_neighbours(true_result):
    """With flashes they may be most of what lies around a good frame, and of them nothing at all is known."""
    known = 0.5 * SETTINGS.joint_deviation
    looked_at = np.array([place not in (1, 2, 4, 5, 7, 8) for place in range(10)])
    energy = dict(true_result.energy)
    results = [replace(true_result, frame=n, energy=energy if seen else {}) for n, seen in enumerate(looked_at)]
    deviations = np.where(looked_at, known, 6 * SETTINGS.joint_deviation)
    assert [doubt.why for doubt in doubted(results, deviations=deviations)] == [
        doubt.why for doubt in doubted(results, deviations=np.full(10, known))
    ]
    assert UNTOLD in [doubt.why for doubt in doubted(results, deviations=6 * deviations)]


def test_where_little_is_known_of_the_joints_the_frame_is_doubtful_but_its_pixels_are_not(true_result):
    results = frames(true_result, 6, bare={4: 1.0, 5: 1.0})
    known, unknown = 0.9 * SETTINGS.joint_deviation, 1.1 * SETTINGS.joint_deviation
    assert doubted(results, deviations=np.full(6, known)) == doubted(results)
    found = doubted(results, deviations=np.array([known, known, unknown, unknown, unknown, unknown]))
    assert [(doubt.first, doubt.last, doubt.why) for doubt in found] == [(2, 3, UNTOLD), (4, 5, OUTLINE)]
    judged = trusted(results, found)
    assert [status for status, _ in judged] == ["ok", "ok", *["doubtful"] * 4]
    np.testing.assert_array_equal(judged[3][1], results[3].confidence)
    assert judged[4][1].max() <= SETTINGS.confidence


def test_where_the_selected_frames_are_wrong_all_are(true_result):
    results = frames(true_result, 10, view_gaps=dict.fromkeys(range(3), FAR))
    assert told(results) == [(0, 2, APART)]
    assert told(results, registered=(1, 20)) == [(0, 2, APART), (3, 9, REGISTERED)]
    assert told(results, registered=(1, 6)) == [(0, 2, APART), (3, 3, REGISTERED)]  # nearer to frame 1
    assert told(results, registered=(1, 6, 8)) == told(results, registered=(6,)) == [(0, 2, APART)]


def test_what_was_not_looked_at_says_nothing(true_result):
    over = replace(true_result, energy={}, signals=None, status="doubtful", frame=3)
    results = [*frames(true_result, 3), over, replace(true_result, frame=4)]
    assert told(results) == []


def test_the_motion_carries_the_verdict(world, true_result, capsys):
    observations = world.observations()
    observations.key_poses = {0: observations.key_poses[0]}
    results = frames(true_result, 3, bare=dict.fromkeys((1, 2), 1.0))
    motion = motion_of(observations, results, verdict=SETTINGS)
    assert motion.status.tolist() == ["ok", "doubtful", "doubtful"]
    assert motion.trusted.tolist() == [True, False, False]
    assert motion.confidence[1:].max() <= SETTINGS.confidence < motion.confidence[0].max()
    assert motion.provenance["doubts"] == [{"first": 1, "last": 2, "why": OUTLINE}]
    assert report_trust(motion) == NOT_TRUSTED
    assert f"frames 1-2: {OUTLINE}" in " ".join(capsys.readouterr().err.split())
    assert motion.provenance["outlier_cameras"] == []
    risks = motion.provenance["risks"]
    assert [risk > SETTINGS.risk for risk in risks["frame"]] == [False, True, True]
    assert risks["frames"] == motion.frames.tolist()
    assert set(risks) == {"frames", "frame", *world.character.skeleton.limb_labels.values()}
    odd = {"camera": "cam1", "first": 0, "last": 2, "why": "it stood still"}
    report_trust(replace(motion, provenance=motion.provenance | {"outlier_cameras": [odd]}))
    assert "cam1 is left out of the verdict in frames 0-2: it stood still." in " ".join(capsys.readouterr().err.split())
    good = motion_of(world.observations(), frames(true_result, 3))
    assert good.trusted.all()
    assert report_trust(good) == 0


def test_frames_of_which_only_a_limb_is_doubted_are_counted_by_themselves():
    found = {"frames": 5, "trusted_frames": 3, "lost_frames": 0, "doubtful_frames": 1}
    assert counted(found) == "5 frames, 3 to be trusted, 1 but for a limb, 0 lost, 1 doubtful"
    assert counted(found | {"trusted_frames": 4}) == "5 frames, 4 to be trusted, 0 lost, 1 doubtful"
