"""Small meshes and a plain z-buffer in double precision, written face by face."""

import numpy as np

INTRINSICS = np.array([[620.0, 0.0, 251.3], [0.0, 612.0, 247.9], [0.0, 0.0, 1.0]])


def camera_at(distance=2.6, turn=0.3, lift=0.1):
    """cam_from_world of a camera that looks at the origin from `distance` metres, `turn` radians to the side."""
    c, s = np.cos(turn), np.sin(turn)
    forward = -np.array([s, lift, c]) / np.linalg.norm([s, lift, c])
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rotation @ (distance * forward)
    return pose


def sphere(rings=12, sectors=20, radius=0.5):
    """Closed sphere about the origin, counter-clockwise seen from outside."""
    theta = np.pi * np.arange(1, rings) / rings
    phi = 2 * np.pi * np.arange(sectors) / sectors
    across, up = np.sin(theta)[:, None], np.cos(theta)[:, None]
    ring = np.stack([across * np.sin(phi), up + 0 * phi, across * np.cos(phi)], -1)
    vertices = radius * np.concatenate([[[0.0, 1.0, 0.0]], ring.reshape(-1, 3), [[0.0, -1.0, 0.0]]])
    number = lambda i, j: 1 + i * sectors + j % sectors  # noqa: E731
    faces = []
    for j in range(sectors):
        faces.append((0, number(0, j), number(0, j + 1)))
        faces.append((len(vertices) - 1, number(rings - 2, j + 1), number(rings - 2, j)))
        for i in range(rings - 2):
            faces.append((number(i, j), number(i + 1, j), number(i + 1, j + 1)))
            faces.append((number(i, j), number(i + 1, j + 1), number(i, j + 1)))
    return vertices, np.array(faces)


def z_buffer(vertices, faces, intrinsics, cam_from_world, origin, height, width):
    """Face numbers (-1 where empty) and inverse depth of a rectangle, pixel centres at + 0.5, all in float64."""
    vertices = np.asarray(vertices, np.float64)
    local = vertices @ np.asarray(cam_from_world, np.float64)[:3, :3].T + np.asarray(cam_from_world, np.float64)[:3, 3]
    pixels = local @ np.asarray(intrinsics, np.float64).T
    pixels = pixels[:, :2] / pixels[:, 2:] - np.asarray(origin)[::-1]
    ids, nearest = np.full((height, width), -1), np.zeros((height, width))
    for number, face in enumerate(np.asarray(faces)):
        if local[face, 2].min() <= 0:
            continue
        a, b, c = pixels[face]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area >= -1e-8:
            continue
        low = np.maximum(np.ceil(np.min([a, b, c], 0) - 0.5), 0).astype(int)
        high = np.minimum(np.floor(np.max([a, b, c], 0) - 0.5), [width - 1, height - 1]).astype(int)
        if (high < low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1) + 0.5, np.arange(low[1], high[1] + 1) + 0.5)
        first = ((b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)) / area
        second = ((c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)) / area
        third = 1 - first - second
        inverse = first / local[face[0], 2] + second / local[face[1], 2] + third / local[face[2], 2]
        window = slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)
        wins = (np.minimum(np.minimum(first, second), third) >= 0) & (inverse > nearest[window])
        ids[window] = np.where(wins, number, ids[window])
        nearest[window] = np.where(wins, inverse, nearest[window])
    return ids, nearest
