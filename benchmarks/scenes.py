"""Small Mitsuba scenes for benchmarks and physics tests: a camera at the origin looks along -z, 20 degrees wide."""

import math

import numpy as np

from holopath_addon.engine.scene.variants import made

FOV = math.radians(20)
GREEN = 516.5e-9


class Scenes:
    """Builders; meters. Needs an active Mitsuba variant."""

    def __init__(self):
        import mitsuba as mi

        self.mi = mi
        self.T = mi.ScalarTransform4f

    def texture(self, cells, seed, low=0.05, high=1.0, contrast=1.0, channels=3):
        """Blocks of three sizes, linear values: detail at several scales, hard edges; dark halves from contrast 2.

        With one channel these are shades between two colors, `low` and `high`.
        """
        rng = np.random.default_rng(seed)
        picture = np.zeros((cells, cells, 3), np.float32)
        for block in (cells // 8, cells // 16, cells // 32):
            coarse = rng.random((cells // block, cells // block, channels)).astype(np.float32)
            picture += np.kron(coarse, np.ones((block, block, 1), np.float32)) / 3
        picture = np.clip(0.5 + contrast * (picture - 0.5), 0, 1)
        return {"type": "bitmap", "bitmap": self.mi.Bitmap(low + (high - low) * picture), "raw": True}

    def gray(self, value):
        return {"type": "rgb", "value": [value] * 3}

    def plane(self, depth, surface, half_width=None, half_height=None, x=0.0, slant=0.0):
        """A rectangle facing the camera at a depth, turned about the vertical by `slant` degrees."""
        half_width = half_width or 1.3 * depth * math.tan(FOV / 2)
        half_height = half_height or half_width
        transform = (
            self.T().translate([x, 0, -depth]).rotate([0, 1, 0], slant).scale([half_width, half_height, 1])
        )
        return {"type": "rectangle", "to_world": transform, **surface}

    def mesh(self, vertices, surface, normals=None):
        """Triangles between vertices [v, u, 3] of a grid, which the texture covers once; smooth with `normals`."""
        rows, columns = np.array(vertices.shape[:2]) - 1
        v, u = np.mgrid[0 : rows + 1, 0 : columns + 1]
        corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
        right, above = corner + 1, corner + columns + 1
        faces = np.concatenate(
            [np.column_stack([corner, right, above + 1]), np.column_stack([corner, above + 1, above])]
        )
        uv = np.stack([u / columns, v / rows], axis=-1)
        return self.triangles(vertices, faces, surface, uv, normals)

    def triangles(self, vertices, faces, surface, uv=None, normals=None):
        """Triangles by the numbers of their vertices [..., 3]; with texture coordinates, and smooth with `normals`."""
        properties, smooth = self.mi.Properties(), normals is not None
        for key, plugin in surface.items():
            properties[key] = made(plugin)
        count, textured = vertices.size // 3, uv is not None
        mesh = self.mi.Mesh(
            "mesh", count, len(faces), properties, has_vertex_normals=smooth, has_vertex_texcoords=textured
        )
        parameters = self.mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        if uv is not None:
            parameters["vertex_texcoords"] = uv.astype(np.float32).ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        if normals is not None:  # after the update, which makes its own, with a seam
            parameters["vertex_normals"] = normals.astype(np.float32).ravel()
            parameters.update()
        return mesh

    def turned(self, radii, heights, foot, surface, sides=48):
        """A smooth mesh of revolution: radii at heights above `foot`, upwards for normals that point outwards."""
        turn = np.linspace(0, 2 * np.pi, sides + 1)
        around = np.stack([np.cos(turn), 0 * turn, -np.sin(turn)], axis=-1)

        def revolve(outwards, upwards):
            return np.multiply.outer(outwards, around) + np.multiply.outer(upwards, [[0, 1, 0]])

        outwards, upwards = np.gradient(heights), -np.gradient(radii)
        length = np.hypot(outwards, upwards)
        normals = revolve(outwards / length, upwards / length)
        return self.mesh(foot + revolve(radii, heights), surface, normals)

    def ball(self, radius, center, surface):
        """A sphere as a mesh."""
        angle = np.linspace(0, np.pi, 25)
        return self.turned(radius * np.sin(angle), -radius * np.cos(angle), center, surface)

    def box(self, low, high, surface, turn=0.0):
        """A box between two corners, turned about its vertical axis by `turn` degrees."""
        low, high = np.array(low), np.array(high)
        place = self.T().translate((low + high) / 2).rotate([0, 1, 0], turn).scale((high - low) / 2)
        return {"type": "cube", "to_world": place, **surface}

    def emissive(self, radiance):
        return {"emitter": {"type": "area", "radiance": radiance}}

    def diffuse(self, reflectance):
        return {"bsdf": {"type": "diffuse", "reflectance": reflectance}}

    def scene(self, **shapes):
        return made({"type": "scene", "embree_use_robust_intersections": True, **shapes})

    def two_planes(self, surface):
        """A textured plane at 2 m behind one at 0.5 m that covers the left half; `surface` emissive or diffuse."""
        half = 0.5 * math.tan(FOV / 2)
        lamp_place = self.T().look_at(origin=[1.5, 2, 1], target=[0, 0, -1.5], up=[0, 1, 0]).scale(0.5)
        return self.scene(
            far=self.plane(2.0, surface(self.texture(256, 1))),
            near=self.plane(0.5, surface(self.texture(128, 2)), 0.5 * half, 0.7 * half, x=-0.55 * half),
            lamp={"type": "rectangle", "to_world": lamp_place, **self.emissive(self.gray(20.0))},
        )

    def three_planes(self, depth=1.0):
        """Emissive planes of strong contrast at 2, `depth` and 0.5 m; the far one fills the view."""
        near, middle = 0.5 * math.tan(FOV / 2), depth * math.tan(FOV / 2)

        def surface(cells, seed):
            return self.emissive(self.texture(cells, seed, contrast=4))

        return self.scene(
            far=self.plane(2.0, surface(256, 1)),
            middle=self.plane(depth, surface(256, 3), 0.3 * middle, 0.35 * middle, x=0.025 * middle),
            near=self.plane(0.5, surface(128, 2), 0.5 * near, 0.6 * near, x=-0.55 * near),
        )

    def floor(self, near=0.5, far=10.0, widen=1.2, side=64):
        """An emissive floor of strong contrast from `near`, below the view, to `far`, above it, without a gap.

        Its texture is as fine near as far, as the viewer sees it.
        """
        v, u = np.mgrid[0 : side + 1, 0 : side + 1] / side
        depth = 1 / (1 / near + (1 / far - 1 / near) * v)
        width = widen * math.tan(FOV / 2) * depth
        vertices = np.stack([(2 * u - 1) * width, (2 * v - 1) * width, -depth], axis=-1)
        return self.scene(floor=self.mesh(vertices, self.emissive(self.texture(256, 4, contrast=4))))

    def glossy_dome(self, roughness, radius=1.0):
        """A shallow metal dome at 0.8 m that mirrors a grid of lamps, roughness as in Blender (alpha is its square)."""
        metal = {"type": "roughconductor", "alpha": roughness**2, "distribution": "ggx"}
        places = [(0.45 * i, 0.45 * j) for i in range(-2, 3) for j in range(-2, 3)]
        lamps = {
            f"lamp_{k}": {
                "type": "rectangle",
                "to_world": self.T().look_at([x, y, 1.0], [0, 0, -0.8], [0, 1, 0]).scale(0.07),
                **self.emissive(self.gray(40.0)),
            }
            for k, (x, y) in enumerate(places)
        }
        return self.scene(
            dome={"type": "sphere", "center": [0, 0, -0.8 - radius], "radius": radius, "bsdf": metal},
            sky={"type": "constant", "radiance": self.gray(0.1)},
            **lamps,
        )

    def closed_box(self):
        """A closed room around the camera, lit by one lamp that shines at the ceiling."""
        T, half = self.T, 0.5
        side = [half, 1.1, 1]
        return self.scene(
            back=self.plane(2.0, self.diffuse(self.texture(256, 5, 0.3, 0.9)), half),
            left={
                "type": "rectangle",
                "to_world": T().translate([-half, 0, -1]).rotate([0, 1, 0], 90).scale([1.1, half, 1]),
                **self.diffuse({"type": "rgb", "value": [0.8, 0.2, 0.1]}),
            },
            right={
                "type": "rectangle",
                "to_world": T().translate([half, 0, -1]).rotate([0, 1, 0], -90).scale([1.1, half, 1]),
                **self.diffuse({"type": "rgb", "value": [0.1, 0.8, 0.2]}),
            },
            floor={
                "type": "rectangle",
                "to_world": T().translate([0, -half, -1]).rotate([1, 0, 0], -90).scale(side),
                **self.diffuse(self.gray(0.7)),
            },
            ceiling={
                "type": "rectangle",
                "to_world": T().translate([0, half, -1]).rotate([1, 0, 0], 90).scale(side),
                **self.diffuse(self.gray(0.7)),
            },
            behind={
                "type": "rectangle",
                "to_world": T().translate([0, 0, 0.1]).rotate([0, 1, 0], 180).scale([half, half, 1]),
                **self.diffuse(self.gray(0.7)),
            },
            lamp={
                "type": "rectangle",
                "to_world": T().translate([0, 0.3, -0.3]).rotate([1, 0, 0], -90).scale([0.12, 0.12, 1]),
                **self.emissive(self.gray(18.0)),
            },
            block={
                "type": "cube",
                "to_world": T().translate([-0.1, -0.1, -0.9]).rotate([0, 1, 0], 25).scale([0.05, 0.1, 0.05]),
                **self.diffuse({"type": "rgb", "value": [0.3, 0.4, 0.8]}),
            },
        )

    def room(self, lamp=1.0, pendant=1.0, moved=0.0, sharp=True, **more):
        """A study that one lamp lights by way of its ceiling, 36 degrees wide: to measure pictures at 0.7 to 4 m in
        which most light has met several everyday surfaces, and how they follow when a lamp or an object changes.

        `lamp` and `pendant` scale the lamps below the ceiling and over the desk, the red box is `moved` to the right by
        meters, and without `sharp` nothing reflects or refracts as a mirror or a lens does: no δ lobes. `more` shapes
        can be put into it.
        """
        T, gray, diffuse, box = self.T, self.gray, self.diffuse, self.box

        def color(red, green, blue):
            return {"type": "rgb", "value": [red, green, blue]}

        def shades(seed, low, high, cells=64):
            return self.texture(cells, seed, np.float32(low), np.float32(high), contrast=2, channels=1)

        def lacquer(reflectance, alpha):
            return {"bsdf": {"type": "roughplastic", "diffuse_reflectance": reflectance, "alpha": alpha}}

        def metal(reflectance, alpha):
            bsdf = {"type": "roughconductor", "alpha": alpha, "distribution": "ggx"}
            return {"bsdf": {**bsdf, "specular_reflectance": reflectance}}

        def both(surface):
            return {"bsdf": {"type": "twosided", "bsdf": surface["bsdf"]}}

        def sphere(radius, center, surface):
            return {"type": "sphere", "center": center, "radius": radius, **surface}

        def panel(center, half_width, half_height, surface, turn=0):
            place = T().translate(center).rotate([0, 1, 0], turn).scale([half_width, half_height, 1])
            return {"type": "rectangle", "to_world": place, **surface}

        def shining(center, up, half, radiance):
            place = T().translate(center).rotate([1, 0, 0], -90 * up).scale([half, half, 1])
            return {"type": "rectangle", "to_world": place, **self.emissive(gray(radiance))}

        def rod(foot, radius, height, surface):
            return self.turned([radius, radius], [0, height], foot, surface, 12)

        def legs(name, columns, rows, low, high, half, surface):
            places = [(x, z) for x in columns for z in rows]
            return {
                f"{name}_leg_{k}": box([x - half, low, z - half], [x + half, high, z + half], surface)
                for k, (x, z) in enumerate(places)
            }

        white, black = diffuse(gray(0.8)), diffuse(gray(0.05))
        oak = lacquer(shades(11, [0.30, 0.17, 0.08], [0.52, 0.33, 0.17]), 0.25)
        walnut = diffuse(shades(12, [0.10, 0.05, 0.03], [0.24, 0.13, 0.07]))
        paper = diffuse(shades(13, [0.55, 0.58, 0.5], [0.8, 0.78, 0.7], 32))
        carpet = diffuse(shades(15, [0.3, 0.04, 0.05], [0.8, 0.6, 0.4]))
        cover = diffuse(shades(19, [0.1, 0.1, 0.1], [0.9, 0.7, 0.3]))
        moss = diffuse(shades(20, [0.1, 0.2, 0.1], [0.5, 0.6, 0.2]))
        marbled = diffuse(shades(21, [0.05, 0.1, 0.4], [0.9, 0.9, 0.6], 32))
        seas = lacquer(shades(17, [0.1, 0.3, 0.5], [0.6, 0.6, 0.3]), 0.15)
        green, cream = lacquer(color(0.1, 0.45, 0.1), 0.1), lacquer(color(0.75, 0.72, 0.6), 0.1)
        red, teal = diffuse(color(0.6, 0.06, 0.04)), diffuse(color(0.05, 0.35, 0.35))
        amber, linen = diffuse(color(0.8, 0.45, 0.05)), diffuse(color(0.75, 0.6, 0.35))
        brass, steel = metal(color(0.9, 0.68, 0.3), 0.2), metal(gray(0.75), 0.3)
        if sharp:
            mirror, glass = {"bsdf": {"type": "conductor"}}, {"bsdf": {"type": "dielectric"}}
            glaze = {"bsdf": {"type": "plastic", "diffuse_reflectance": color(0.05, 0.12, 0.5)}}
        else:
            mirror, glass = diffuse(gray(0.6)), diffuse(color(0.5, 0.6, 0.55))
            glaze = diffuse(color(0.05, 0.12, 0.5))

        walls = {
            "floor": box([-1.1, -1.05, -4.1], [1.2, -0.95, 0.7], oak),
            "ceiling": box([-1.1, 1.2, -4.1], [1.2, 1.3, 0.7], white),
            "left": box([-1.1, -1, -4.1], [-1, 1.25, 0.7], diffuse(color(0.75, 0.5, 0.3))),
            "right": box([1.1, -1, -4.1], [1.2, 1.25, 0.7], diffuse(color(0.45, 0.6, 0.65))),
            "far": box([-1.1, -1, -4.1], [1.2, 1.25, -4], paper),
            "behind": box([-1.1, -1, 0.6], [1.2, 1.25, 0.7], diffuse(gray(0.65))),
            "carpet": box([-0.8, -0.95, -3.6], [0.5, -0.935, -1.6], carpet),
            "frame": box([-0.12, 0.1, -4], [0.42, 0.64, -3.97], black),
            "picture": panel([0.15, 0.37, -3.968], 0.23, 0.23, diffuse(self.texture(64, 16, contrast=3))),
            "mirror_frame": box([0.57, -0.12, -4], [0.93, 0.36, -3.97], brass),
            "mirror": panel([0.75, 0.12, -3.968], 0.15, 0.21, mirror),
            "mirrored": panel([1.098, 0.2, -2.2], 0.8, 0.2, diffuse(self.texture(64, 14, contrast=3)), -90),
        }
        shelf = {
            "shelf_left": box([-0.95, -0.95, -4], [-0.92, 0.5, -3.72], walnut),
            "shelf_right": box([-0.25, -0.95, -4], [-0.22, 0.5, -3.72], walnut),
            "globe": self.ball(0.11, [-0.6, 0.61, -3.85], seas),
            "jar": sphere(0.07, [-0.36, 0.57, -3.83], steel),
        }
        rng = np.random.default_rng(18)
        for level, y in enumerate((-0.9, -0.43, 0.02, 0.47)):
            shelf[f"board_{level}"] = box([-0.92, y, -4], [-0.25, y + 0.03, -3.72], walnut)
            x = -0.91
            while level < 3 and x < -0.36 - 0.1 * level:
                width, height, depth = rng.uniform([0.03, 0.2, 0.14], [0.07, 0.36, 0.22])
                dye = rng.uniform(0.05, 0.7, 3)
                spine = color(*dye) if rng.random() < 0.5 else shades(len(shelf), 0.3 * dye, dye, 32)
                corners = [x, y + 0.03, -4], [x + width - 0.004, y + 0.03 + height, depth - 4]
                shelf[f"book_{len(shelf)}"] = box(*corners, diffuse(spine))
                x += width

        up = np.linspace(0, 1, 33)
        swell = 0.035 + 0.03 * np.sin(np.pi * up**0.8) - 0.025 * up**2 + 0.02 * up**6
        desk = {
            "desk": box([0.0, -0.31, -2.1], [1.1, -0.28, -0.78], oak),
            **legs("desk", (0.04, 1.06), (-2.06, -0.82), -0.95, -0.31, 0.025, walnut),
            "book_below": box([0.06, -0.28, -0.9], [0.24, -0.25, -0.68], teal, 8),
            "book_above": box([0.07, -0.25, -0.88], [0.22, -0.225, -0.7], cover, -12),
            "vase": self.turned(swell, 0.22 * up, [0.4, -0.28, -1.5], both(cream), 64),
            "box": box([0.12 + moved, -0.28, -1.42], [0.23 + moved, -0.17, -1.31], red, 30),
            "marble": sphere(0.055, [0.31, -0.225, -1.15], glaze),
            "paperweight": sphere(0.035, [0.2, -0.245, -1.02], glass),
            "knob": self.ball(0.07, [0.26, -0.21, -1.85], brass),
        }
        half_turn = np.linspace(0, np.pi, 33)
        width, height = 0.26 * np.sqrt(np.sin(half_turn)), 0.17 * (1 - np.cos(half_turn))
        seats = {
            "seat": box([-0.46, -0.5, -2.6], [-0.08, -0.46, -2.2], teal),
            "back": box([-0.49, -0.46, -2.6], [-0.46, -0.1, -2.2], teal),
            **legs("chair", (-0.44, -0.1), (-2.58, -2.22), -0.95, -0.5, 0.015, steel),
            "pouf": self.turned(width, height, [-0.68, -0.935, -2.3], moss),
            "toy": sphere(0.115, [-0.05, -0.82, -3.2], amber),
        }
        lamps = {
            "pole": rod([-0.66, -0.95, -2.6], 0.014, 1.2, steel),
            "reflector": self.turned([0.02, 0.12, 0.17], [0, 0.03, 0.16], [-0.66, 0.24, -2.6], both(white)),
            "lamp": shining([-0.66, 0.38, -2.6], 1, 0.1, 300 * lamp),
            "cord": rod([0.38, 0.5, -1.65], 0.004, 0.7, black),
            "shade": self.turned([0.15, 0.04], [0, 0.17], [0.38, 0.33, -1.65], both(linen)),
            "pendant": shining([0.38, 0.44, -1.65], -1, 0.04, 160 * pendant),
        }
        hanging = [
            (-0.09, 0.2, -0.95, red),
            (-0.26, 0.32, -1.2, brass),
            (-0.03, 0.42, -1.6, marbled),
            (0.11, 0.3, -1.35, green),
        ]
        mobile = {}
        for k, (x, y, z, surface) in enumerate(hanging):
            mobile[f"ball_{k}"] = self.ball(0.045, [x, y, z], surface)
            mobile[f"string_{k}"] = rod([x, y + 0.045, z], 0.002, 1.155 - y, black)
        return self.scene(**walls, **shelf, **desk, **seats, **lamps, **mobile, **more)
