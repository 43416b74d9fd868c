import numpy as np
import pytest
from box_figure import box_character, box_motion

from jaxmocap.camera import project
from jaxmocap.viewers import OverlayStyle, contact_sheet, draw_overlay, paint_face_ids

INTRINSICS = np.array([[100.0, 0, 60], [0, 100, 40], [0, 0, 1]])
FACING = np.diag([1.0, -1, -1, 1])  # looks along the world's -z, y up
FACING[2, 3] = 10.0
SIZE = (120, 80)
GREY = np.full((80, 120, 3), 100, np.uint8)
# A square of 4 x 2 m at the origin, split along a diagonal: 40 x 20 pixels, columns 40..79, rows 30..49.
SQUARE = np.array([[-2.0, -1, 0], [2, -1, 0], [2, 1, 0], [-2, 1, 0]])
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])
ONLY_MESH = OverlayStyle(contour=0, bones=0, verdict=False)


def test_painted_faces_lie_where_the_camera_puts_them():
    ids = paint_face_ids(SQUARE, SQUARE_FACES, INTRINSICS, FACING, SIZE)
    inside = np.zeros_like(ids, bool)
    inside[31:49, 41:79] = True
    around = np.zeros_like(inside)
    around[29:51, 39:81] = True
    assert (ids[inside] >= 0).all()
    assert (ids[~around] == -1).all()
    assert set(ids[inside].tolist()) == {0, 1}
    assert ids[47, 70] == 0  # the lower right half
    assert ids[32, 50] == 1


def test_the_nearer_face_is_seen():
    behind = SQUARE + [0.0, 0.0, -1.0]
    for vertices, seen in (((SQUARE, behind), {0, 1}), ((behind, SQUARE), {2, 3})):
        ids = paint_face_ids(
            np.concatenate(vertices), np.concatenate([SQUARE_FACES, SQUARE_FACES + 4]), INTRINSICS, FACING, SIZE
        )
        assert set(ids[32:48, 42:78].ravel().tolist()) == seen


def test_faces_behind_the_camera_are_not_drawn():
    for distance in (10.0, 30.0):
        ids = paint_face_ids(SQUARE + [0, 0, distance], SQUARE_FACES, INTRINSICS, FACING, SIZE)
        assert (ids == -1).all()


def test_shading_follows_the_angle_to_the_light():
    def shade(tilt):
        turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
        style = OverlayStyle(opacity=1.0, contour=0, bones=0, verdict=False)
        drawn = draw_overlay(GREY, SQUARE @ turn.T, SQUARE_FACES, INTRINSICS, FACING, style=style)
        return drawn[40, 60].astype(float)

    upright, towards_light, away = shade(0.0), shade(-0.7), shade(1.2)
    assert (towards_light > upright).all()
    assert (upright > away).all()
    assert np.allclose(away / towards_light, (away / towards_light)[0], atol=0.02)  # one hue, darker
    flipped = draw_overlay(
        GREY, SQUARE, SQUARE_FACES[:, ::-1], INTRINSICS, FACING, style=OverlayStyle(opacity=1.0, contour=0)
    )
    assert np.array_equal(flipped[40, 60], upright.astype(np.uint8))


def test_the_mesh_is_mixed_with_the_image_by_its_opacity_and_nothing_else_changes():
    draw = lambda opacity: draw_overlay(  # noqa: E731
        GREY, SQUARE, SQUARE_FACES, INTRINSICS, FACING, style=OverlayStyle(opacity, contour=0, bones=0, verdict=False)
    ).astype(float)
    full, half = draw(1.0), draw(0.5)
    assert np.allclose(half[40, 60], (full[40, 60] + 100) / 2, atol=1)
    assert np.array_equal(draw(0.0), GREY)
    assert (half[:28] == 100).all()
    assert (GREY == 100).all()


def test_given_ids_are_used_as_they_are():
    ids = np.full((80, 120), -1)
    ids[5:10, 100:110] = 1
    drawn = draw_overlay(GREY, SQUARE, SQUARE_FACES, INTRINSICS, FACING, ids=ids, style=ONLY_MESH)
    changed = (drawn != GREY).any(-1)
    assert np.array_equal(changed, ids >= 0)


def test_the_contour_runs_along_the_edge_of_the_silhouette():
    drawn = draw_overlay(
        GREY, SQUARE, SQUARE_FACES, INTRINSICS, FACING, style=OverlayStyle(0.0, contour=1, bones=0, verdict=False)
    )
    rows, columns = np.nonzero((drawn == 255).all(-1))
    covered = paint_face_ids(SQUARE, SQUARE_FACES, INTRINSICS, FACING, SIZE) >= 0
    assert rows.min() == np.flatnonzero(covered.any(1)).min()
    assert columns.max() == np.flatnonzero(covered.any(0)).max()
    assert (drawn[35:45, 45:75] == 100).all()


def test_bones_join_projected_joints_and_tell_their_confidence():
    joints = np.array([[-3.0, 0, 0], [3.0, 0, 0], [0, 0, 0]])
    names = ("l_elbow", "l_wrist", "unrelated")
    style = OverlayStyle(0.0, contour=0, bones=2, verdict=False)
    sure, unsure = (
        draw_overlay(
            *(GREY, SQUARE, SQUARE_FACES, INTRINSICS, FACING),
            joints=joints,
            joint_names=names,
            confidence=np.full(3, value),
            style=style,
        )
        for value in (1.0, 0.0)
    )
    pixels, _ = project(INTRINSICS, FACING, joints)
    for column in (35, 60, 85):  # from (30, 40) to (90, 40)
        assert sure[39, column, 1] > sure[39, column, 0] + 100
        assert unsure[39, column, 0] > unsure[39, column, 1] + 100
    assert np.allclose(pixels[:2], [[30, 40], [90, 40]])
    assert (sure[:30] == 100).all()
    assert (sure[:, :24] == 100).all()


def test_joints_behind_the_camera_do_not_harm():
    joints = np.array([[0.0, 0, 20], [0.0, 0, 0]])
    drawn = draw_overlay(
        *(GREY, SQUARE, SQUARE_FACES, INTRINSICS, FACING),
        joints=joints,
        joint_names=("l_elbow", "l_wrist"),
        style=OverlayStyle(0.0, contour=0, verdict=False),
    )
    assert (drawn[:30] == 100).all()
    assert (drawn[40, 60] != 100).any()


@pytest.mark.parametrize(("status", "hue"), [("lost", 0), ("doubtful", 0), ("ok", None)])
def test_the_border_tells_the_verdict(status, hue):
    drawn = draw_overlay(GREY, SQUARE, SQUARE_FACES, INTRINSICS, FACING, status=status)
    edges = np.concatenate([drawn[0], drawn[-1], drawn[:, 0], drawn[:, -1]]).astype(int)
    if hue is None:
        assert (edges == 100).all()
    else:
        assert (edges[:, 0] > 220).all()
        assert (edges[:, 2] < 70).all()
        assert ((edges[:, 1] > 120) == (status == "doubtful")).all()


def test_a_whole_figure_covers_its_projected_vertices():
    character = box_character()
    motion = box_motion(character, num_frames=1)
    camera = FACING.copy()
    camera[1, 3], camera[2, 3] = 1.0, 4.0
    ids = paint_face_ids(motion.vertices(0), np.asarray(character.faces), INTRINSICS, camera, SIZE)
    pixels, _ = project(INTRINSICS, camera, motion.vertices(0))
    boxes = np.asarray(pixels).reshape(18, 8, 2).mean(1)  # the middle of each box
    inside = ((boxes > 1) & (boxes < [119, 79])).all(1)
    assert inside.sum() > 10
    columns, rows = np.floor(boxes[inside]).astype(int).T
    assert (ids[rows, columns] >= 0).all()


def test_a_contact_sheet_keeps_order_and_fills_with_white():
    images = [np.full((10, 16, 3), value, np.uint8) for value in (1, 2, 3)]
    sheet = contact_sheet(images, 2, gap=2)
    assert sheet.shape == (22, 34, 3)
    assert (sheet[:10, :16] == 1).all()
    assert (sheet[:10, 18:] == 2).all()
    assert (sheet[12:, :16] == 3).all()
    assert (sheet[12:, 18:] == 255).all()
    assert contact_sheet(images[:1], 5).shape == (10, 16, 3)
    with pytest.raises(ValueError, match="at least one image"):
        contact_sheet([], 2)
