"""A head with hair under soft light, before a wall: what a person looks at first, and the finest things in its view."""

import numpy as np

CENTER = np.array([0.0, -0.005, -0.75])  # of the head, which faces the camera; meters
RADII = np.array([0.074, 0.108, 0.088])  # to the side, up and to the front
EYES = 0.031, 0.014  # to each side and up from the head's center
STRANDS, JOINTS = 1000, 6
STRAND_RADIUS = 0.0009  # meters, a pixel of a hologram of 256 pixels; thinner towards the end
DYES = (0.09, 0.045, 0.02), (0.16, 0.08, 0.035), (0.26, 0.15, 0.07)


def portrait(s):
    """The scene.

    Parameters
    ----------
    s : Scenes
    """
    return s.scene(
        head=_head(s),
        neck=s.turned([0.05, 0.045, 0.052], [0, 0.06, 0.12], CENTER - [0, 0.2, 0.02], _skin(s, 0.5)),
        shoulders=_egg(
            s, CENTER - [0, 0.245, 0.03], (0.23, 0.11, 0.1), s.diffuse(s.texture(64, 61, 0.1, 0.5))
        ),
        wall=s.plane(2.2, s.diffuse(s.texture(256, 62, 0.15, 0.7))),
        lamp=_lamp(s, [-0.9, 0.7, 0.1], 0.5, 6.0),
        rim=_lamp(s, [0.8, 0.6, -1.4], 0.25, 9.0),
        sky={"type": "constant", "radiance": s.gray(0.25)},
        **_eyes(s),
        **_hair(s),
    )


def _lamp(s, place, size, radiance):
    """A square lamp that shines at the head."""
    to_world = s.T().look_at(origin=place, target=CENTER.tolist(), up=[0, 1, 0]).scale(size)
    return {"type": "rectangle", "to_world": to_world, **s.emissive(s.gray(radiance))}


def _directions(rows, columns):
    """Unit vectors [row, column, 3] all over a sphere, from below upwards, around the vertical from the back."""
    height, turn = np.linspace(-np.pi / 2, np.pi / 2, rows), np.linspace(-np.pi, np.pi, columns)
    around = np.stack([np.sin(turn), 0 * turn, np.cos(turn)], axis=-1)
    return np.cos(height)[:, None, None] * around + np.sin(height)[:, None, None] * np.array([0, 1, 0])


def _surface(directions):
    """Points of the head's surface in directions from its center, relative to that."""
    x, y, z = np.moveaxis(directions, -1, 0)
    front = np.clip(z, 0, None)

    def bump(height, across, up, width, tall):
        return height * front * np.exp(-(((x - across) / width) ** 2) - ((y - up) / tall) ** 2)

    out = 1 + bump(0.27, 0, -0.14, 0.09, 0.13) + bump(0.08, 0, 0.02, 0.06, 0.2)  # nose
    out += sum(bump(-0.09, side * 0.4, 0.13, 0.2, 0.12) for side in (-1, 1))  # sockets of the eyes
    out += (
        bump(0.05, 0, -0.52, 0.22, 0.05) + bump(0.045, 0, -0.6, 0.18, 0.05) + bump(0.07, 0, -0.82, 0.3, 0.15)
    )
    narrow = np.where(y < 0, 1 - 0.22 * y**2, 1.0)  # towards the chin
    return directions * RADII * out[..., None] * np.stack([narrow, np.ones_like(y), np.ones_like(y)], axis=-1)


def _grid(s, center, points, surface):
    """A smooth mesh through a grid of points around a center."""
    along_v, along_u = np.gradient(points, axis=0), np.gradient(points, axis=1)
    normals = np.cross(along_u, along_v)
    normals[[0, -1]] = points[[0, -1]]  # at the poles nothing goes on along the rows
    return s.mesh(center + points, surface, normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def _egg(s, center, radii, surface):
    return _grid(s, center, _directions(33, 65) * np.array(radii), surface)


def _skin(s, shade=1.0, texture=None):
    reflectance = texture or {"type": "rgb", "value": [0.62 * shade, 0.4 * shade, 0.3 * shade]}
    skin = {"type": "roughplastic", "distribution": "ggx", "diffuse_reflectance": reflectance, "alpha": 0.35}
    return {"bsdf": {"type": "twosided", "bsdf": skin}}


def _head(s):
    """Lips and brows are painted on, and freckles."""
    rows, columns = 161, 241
    directions = _directions(rows, columns)
    x, y, z = np.moveaxis(directions, -1, 0)
    paint = np.ones((rows, columns, 3)) * [0.62, 0.4, 0.3]

    def put(dye, amount):
        paint[:] += np.clip(amount * (z > 0), 0, 1)[..., None] * (np.array(dye) - paint)

    put([0.5, 0.12, 0.1], 1.5 * np.exp(-((x / 0.24) ** 4) - ((y + 0.56) / 0.08) ** 4))
    for side in (-1, 1):
        brow = 0.3 - 0.25 * (x - side * 0.36) ** 2
        put([0.08, 0.05, 0.03], 1.5 * np.exp(-(((x - side * 0.36) / 0.2) ** 6) - ((y - brow) / 0.045) ** 2))
        put([0.7, 0.32, 0.25], 0.5 * np.exp(-(((x - side * 0.5) / 0.25) ** 2) - ((y + 0.25) / 0.25) ** 2))
    paint *= 1 - 0.25 * (np.random.default_rng(60).random((rows, columns, 1)) > 0.93)
    picture = {"type": "bitmap", "bitmap": s.mi.Bitmap(paint.astype(np.float32)), "raw": True}
    return _grid(s, CENTER, _surface(directions), _skin(s, texture=picture))


def _eyes(s):
    white = {"type": "plastic", "diffuse_reflectance": s.gray(0.7)}
    iris = {"type": "plastic", "diffuse_reflectance": {"type": "rgb", "value": [0.03, 0.09, 0.12]}}
    shapes = {}
    for side in (-1, 1):
        place = CENTER + [side * EYES[0], EYES[1], 0.06]
        shapes[f"eye_{side}"] = s.ball(0.0135, place, {"bsdf": white})
        shapes[f"iris_{side}"] = s.ball(0.0068, place + [0, 0, 0.0085], {"bsdf": iris})
    return shapes


def _hair(s):
    """Strands that grow from the scalp and fall beside the face, in three shades."""
    rng = np.random.default_rng(63)
    directions = rng.normal(size=(6 * STRANDS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    scalp = (y > 0.62) | ((z < 0.35) & (y > -0.1)) | ((np.abs(x) > 0.75) & (y > 0.1))
    directions = directions[scalp][:STRANDS]
    place, way = 1.01 * _surface(directions), directions + 0.25 * rng.normal(size=directions.shape)
    way[:, 0] += 0.6 * np.sign(directions[:, 0] + 0.15)  # parted a little beside the middle
    way[:, 2] = np.minimum(way[:, 2], -0.1)  # and combed back
    step = rng.uniform(0.03, 0.045, (len(directions), 1))
    strands = [place]
    for _ in range(JOINTS - 1):
        way = way / np.linalg.norm(way, axis=1, keepdims=True) + [0, -0.6, 0]
        way += 0.08 * rng.normal(size=way.shape)
        place = place + step * way / np.linalg.norm(way, axis=1, keepdims=True)
        inside = np.linalg.norm(place / RADII, axis=1, keepdims=True)
        place = np.where(inside < 1.06, 1.06 * place / inside, place)
        before_face = (place[:, 2] > 0.02) & (place[:, 1] < 0.05) & (np.abs(place[:, 0]) < 0.066)
        place[:, 0] = np.where(before_face, np.copysign(0.068, place[:, 0]), place[:, 0])
        strands.append(place)
    strands = CENTER + np.stack(strands, axis=1)
    return {
        f"hair_{number}": _tubes(
            s, strands[number :: len(DYES)], s.diffuse({"type": "rgb", "value": list(dye)})
        )
        for number, dye in enumerate(DYES)
    }


def _tubes(s, lines, surface):
    """Tubes of three sides, thinner towards their ends, around lines [line, joint, 3]."""
    ways = np.gradient(lines, axis=1)
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    across = np.cross(ways, [0.3, 0.1, 1.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    up, turns = np.cross(ways, across), 2 * np.pi * np.arange(3) / 3
    normals = np.stack([np.cos(turn) * across + np.sin(turn) * up for turn in turns], axis=2)
    radii = STRAND_RADIUS * np.linspace(1, 0.5, lines.shape[1])[:, None, None]
    count, joints = lines.shape[:2]
    number = np.arange(count * joints * 3).reshape(count, joints, 3)
    low, high = number[:, :-1], number[:, 1:]
    beside, above = np.roll(low, -1, axis=2), np.roll(high, -1, axis=2)
    faces = np.concatenate(
        [np.stack(three, axis=-1).reshape(-1, 3) for three in ((low, beside, above), (low, above, high))]
    )
    return s.triangles(lines[:, :, None] + radii * normals, faces, surface, normals=normals)
