"""The two drivers, drawing in parts, and overflow: bit for bit."""

import platform

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import INTRINSICS, camera_at

from jaxmocap.render import (
    WINDOW,
    Faces,
    KeyLayout,
    crop,
    draw,
    draw_scatter,
    empty_buffer,
    expand,
    expand_one_by_one,
    inverse_depth_range,
    planned_windows,
    projection_matrices,
    to_screen,
    window_list,
)

HEIGHT, WIDTH, CAPACITY = 240, 176, 8192


class Picture:
    """The actor before one camera, in a rectangle that begins at `origin` of the image."""

    def __init__(self, actor, vertices, origin):
        camera = jnp.asarray(camera_at(2.6, 0.2), jnp.float32)
        projection = projection_matrices(jnp.asarray(INTRINSICS, jnp.float32), camera)
        self.faces = jnp.asarray(actor.faces).T
        self.layout = KeyLayout.for_faces(self.faces.shape[1])
        self.screen = to_screen(jnp.asarray(vertices), projection, jnp.asarray(origin, jnp.int32))
        self.depth_range = inverse_depth_range(jnp.asarray(vertices), camera)
        self.numbers = jnp.arange(self.faces.shape[1], dtype=jnp.int32)

    def listed(self, faces=None, numbers=None, active=None, capacity=CAPACITY, size=(HEIGHT, WIDTH)):
        faces = self.faces if faces is None else faces
        numbers = self.numbers if numbers is None else numbers
        drawn = Faces(faces, numbers, active)
        return _list(self.screen, drawn, size, self.depth_range, self.layout, capacity)[0]

    def draw(self, listed, buffer=None, size=(HEIGHT, WIDTH)):
        buffer = empty_buffer(self.layout, *size) if buffer is None else buffer
        return _draw(buffer, listed, self.layout)


_list = jax.jit(window_list, static_argnums=(2, 4, 5))
_draw = jax.jit(draw, static_argnums=2)
_scatter = jax.jit(draw_scatter, static_argnums=2)

ORIGINS = {"whole body": (40, 170), "cut by the rectangle": (151, 203)}


@pytest.fixture(scope="module", params=ORIGINS.values(), ids=ORIGINS.keys())
def picture(actor, dancers, request):
    return Picture(actor, dancers[2], request.param)


@pytest.fixture(scope="module")
def limb(actor):
    """Faces of the left forearm and hand."""
    names = actor.skeleton.body_names
    weights = np.asarray(actor.weights)[:, [names.index("l_forearm"), names.index("l_hand")]].sum(1)
    return (weights > 0)[np.asarray(actor.faces)].any(1)


def test_both_drivers_give_the_same_bits(picture):
    """In several places, since a depth on the edge between two levels is rare; and compiled for a processor that has no
    multiply-add, too."""
    drivers = [_scatter] + [
        jax.jit(driver, static_argnums=2, compiler_options={"xla_cpu_max_isa": "AVX"})
        for driver in (draw, draw_scatter)
        if platform.machine() == "x86_64" and jax.default_backend() == "cpu"
    ]
    screen = picture.screen
    for shift in np.linspace(0.0, 3.0, 8, dtype=np.float32):
        picture.screen = screen.at[:2].add(shift)
        listed = picture.listed()
        assert 500 < int(listed.count) <= CAPACITY
        looped = crop(picture.draw(listed))
        assert (np.asarray(picture.layout.face(looped)) >= 0).sum() > 2000
        for driver in drivers:
            other = crop(driver(empty_buffer(picture.layout, HEIGHT, WIDTH), listed, picture.layout))
            np.testing.assert_array_equal(looped, other)
    picture.screen = screen


def test_both_drivers_give_the_same_bits_over_a_buffer_that_holds_something(picture, limb):
    base = picture.draw(picture.listed(active=jnp.asarray(~limb)))
    listed = picture.listed(active=jnp.asarray(limb))
    np.testing.assert_array_equal(crop(picture.draw(listed, base)), crop(_scatter(base, listed, picture.layout)))


def test_a_limb_drawn_over_the_rest_gives_the_bits_of_the_whole(picture, limb):
    whole = picture.draw(picture.listed())
    rest = picture.draw(picture.listed(active=jnp.asarray(~limb)))
    own = jnp.asarray(np.flatnonzero(limb), jnp.int32)
    listed = picture.listed(faces=picture.faces[:, own], numbers=own, capacity=1024)
    assert int(listed.needed) <= 1024
    np.testing.assert_array_equal(crop(picture.draw(listed, rest)), crop(whole))
    assert np.any(np.asarray(crop(rest)) != np.asarray(crop(whole)))


def test_the_order_of_the_faces_does_not_change_the_faces_seen(picture):
    order = np.random.default_rng(0).permutation(picture.faces.shape[1]).astype(np.int32)
    shuffled = picture.listed(faces=picture.faces[:, order], numbers=jnp.asarray(order))
    np.testing.assert_array_equal(crop(picture.draw(shuffled)), crop(picture.draw(picture.listed())))


def test_overflow_is_reported_and_draws_a_part(picture):
    enough = picture.listed()
    needed = int(enough.needed)
    short = picture.listed(capacity=256)
    assert int(short.needed) == needed > 256
    assert int(short.count) == 256
    exact = picture.listed(capacity=needed)
    assert int(exact.count) == needed
    np.testing.assert_array_equal(picture.draw(exact), picture.draw(enough))
    missing = np.asarray(picture.draw(short)) != np.asarray(picture.draw(enough))
    assert missing.any()


def test_windows_stay_inside_the_border(picture):
    listed = picture.listed()
    windows = planned_windows(listed, listed.item, listed.rank)
    corners = np.stack([windows.column, windows.row], 1)[: int(listed.count)]
    assert corners.min() >= 0
    assert np.all(corners + WINDOW <= [WIDTH + 2 * WINDOW, HEIGHT + 2 * WINDOW])


@pytest.mark.parametrize("picture", [ORIGINS["whole body"]], indirect=True)
def test_mapping_over_particles_gives_the_same_bits_as_one_at_a_time(picture):
    """What a search does: poses one after the other by `lax.map`, or all at once by `vmap` of the scatter."""
    shifts = jnp.array([0.0, 3.3, -8.7])

    def keys(shift, driver):
        screen = picture.screen.at[0].add(shift)
        faces = Faces(picture.faces, picture.numbers)
        listed, _ = window_list(screen, faces, (HEIGHT, WIDTH), picture.depth_range, picture.layout, CAPACITY)
        return crop(driver(empty_buffer(picture.layout, HEIGHT, WIDTH), listed, picture.layout))

    looped = np.asarray(jax.jit(lambda s: jax.lax.map(lambda one: keys(one, draw), s))(shifts))
    mapped = np.asarray(jax.jit(jax.vmap(lambda one: keys(one, draw_scatter)))(shifts))
    alone = crop(picture.draw(picture.listed()))
    np.testing.assert_array_equal(looped, mapped)
    np.testing.assert_array_equal(looped[0], alone)
    assert np.any(looped[1] != looped[0])


ways_to_expand = pytest.mark.parametrize("way", [expand, expand_one_by_one])


@ways_to_expand
def test_expansion_repeats_items_by_their_counts(way):
    counts = np.array([0, 3, 0, 1, 2, 0], np.int32)
    item, rank, total = way(jnp.asarray(counts), 10)
    assert int(total) == 6
    np.testing.assert_array_equal(item[:6], np.repeat(np.arange(6), counts))
    np.testing.assert_array_equal(rank[:6], [0, 1, 2, 0, 0, 1])


@ways_to_expand
def test_expansion_fills_what_room_there_is(way):
    item, rank, total = way(jnp.array([2, 0, 3, 4], jnp.int32), 4)
    assert int(total) == 9
    np.testing.assert_array_equal(item, [0, 0, 2, 2])
    np.testing.assert_array_equal(rank, [0, 1, 0, 1])


@ways_to_expand
def test_expansion_of_nothing(way):
    _, _, total = way(jnp.zeros(5, jnp.int32), 4)
    assert int(total) == 0


@ways_to_expand
@pytest.mark.parametrize("length", [1, 64, 5_000, 16_385, 300_000])
def test_items_are_repeated_as_often_as_said_however_many_there_are(length, way):
    counts = np.random.default_rng(0).integers(0, 4, length).astype(np.int32)
    item, rank, total = way(jnp.asarray(counts), 4 * length)
    assert int(total) == counts.sum()
    expected = np.repeat(np.arange(length), counts)
    np.testing.assert_array_equal(item[:total], expected)
    np.testing.assert_array_equal(rank[:total], np.arange(total) - (np.cumsum(counts) - counts)[expected])
