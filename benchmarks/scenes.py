"""Small Mitsuba scenes for benchmarks and physics tests: a camera at the origin looks along -z, 20 degrees wide."""

import math

import numpy as np

FOV = math.radians(20)
GREEN = 516.5e-9


class Scenes:
    """Builders; metres. Needs an active Mitsuba variant."""

    def __init__(self):
        import mitsuba as mi

        self.mi = mi
        self.T = mi.ScalarTransform4f

    def texture(self, cells, seed, low=0.05, high=1.0, contrast=1.0):
        """Blocks of three sizes, linear values: detail at several scales, hard edges; dark halves from contrast 2."""
        rng = np.random.default_rng(seed)
        picture = np.zeros((cells, cells, 3), np.float32)
        for block in (cells // 8, cells // 16, cells // 32):
            coarse = rng.random((cells // block, cells // block, 3)).astype(np.float32)
            picture += np.kron(coarse, np.ones((block, block, 1), np.float32)) / 3
        picture = np.clip(0.5 + contrast * (picture - 0.5), 0, 1)
        return {"type": "bitmap", "bitmap": self.mi.Bitmap(low + (high - low) * picture), "raw": True}

    def grey(self, value):
        return {"type": "rgb", "value": [value] * 3}

    def plane(self, depth, surface, half_width=None, half_height=None, x=0.0, slant=0.0):
        """A rectangle facing the camera at a depth, turned about the vertical by `slant` degrees."""
        half_width = half_width or 1.3 * depth * math.tan(FOV / 2)
        half_height = half_height or half_width
        transform = (
            self.T().translate([x, 0, -depth]).rotate([0, 1, 0], slant).scale([half_width, half_height, 1])
        )
        return {"type": "rectangle", "to_world": transform, **surface}

    def emissive(self, radiance):
        return {"emitter": {"type": "area", "radiance": radiance}}

    def diffuse(self, reflectance):
        return {"bsdf": {"type": "diffuse", "reflectance": reflectance}}

    def scene(self, **shapes):
        return self.mi.load_dict({"type": "scene", **shapes})

    def two_planes(self, surface):
        """A textured plane at 2 m behind one at 0.5 m that covers the left half; `surface` emissive or diffuse."""
        half = 0.5 * math.tan(FOV / 2)
        lamp_place = self.T().look_at(origin=[1.5, 2, 1], target=[0, 0, -1.5], up=[0, 1, 0]).scale(0.5)
        return self.scene(
            far=self.plane(2.0, surface(self.texture(256, 1))),
            near=self.plane(0.5, surface(self.texture(128, 2)), 0.5 * half, 0.7 * half, x=-0.55 * half),
            lamp={"type": "rectangle", "to_world": lamp_place, **self.emissive(self.grey(20.0))},
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
        v, u = np.mgrid[0 : side + 1, 0 : side + 1].reshape(2, -1) / side
        depth = 1 / (1 / near + (1 / far - 1 / near) * v)
        width = widen * math.tan(FOV / 2) * depth
        vertices = np.column_stack([(2 * u - 1) * width, (2 * v - 1) * width, -depth])
        corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
        right, above = corner + 1, corner + side + 1
        faces = np.concatenate(
            [np.column_stack([corner, right, above + 1]), np.column_stack([corner, above + 1, above])]
        )
        properties = self.mi.Properties()
        properties["emitter"] = self.mi.load_dict(
            {"type": "area", "radiance": self.texture(256, 4, contrast=4)}
        )
        mesh = self.mi.Mesh("floor", len(vertices), len(faces), props=properties, has_vertex_texcoords=True)
        parameters = self.mi.traverse(mesh)
        parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
        parameters["vertex_texcoords"] = np.column_stack([u, v]).astype(np.float32).ravel()
        parameters["faces"] = faces.astype(np.uint32).ravel()
        parameters.update()
        return self.scene(floor=mesh)

    def glossy_dome(self, roughness, radius=1.0):
        """A shallow metal dome at 0.8 m that mirrors a grid of lamps, roughness as in Blender (alpha is its square)."""
        metal = {"type": "roughconductor", "alpha": roughness**2, "distribution": "ggx"}
        places = [(0.45 * i, 0.45 * j) for i in range(-2, 3) for j in range(-2, 3)]
        lamps = {
            f"lamp_{k}": {
                "type": "rectangle",
                "to_world": self.T().look_at([x, y, 1.0], [0, 0, -0.8], [0, 1, 0]).scale(0.07),
                **self.emissive(self.grey(40.0)),
            }
            for k, (x, y) in enumerate(places)
        }
        return self.scene(
            dome={"type": "sphere", "center": [0, 0, -0.8 - radius], "radius": radius, "bsdf": metal},
            sky={"type": "constant", "radiance": self.grey(0.1)},
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
                **self.diffuse(self.grey(0.7)),
            },
            ceiling={
                "type": "rectangle",
                "to_world": T().translate([0, half, -1]).rotate([1, 0, 0], 90).scale(side),
                **self.diffuse(self.grey(0.7)),
            },
            behind={
                "type": "rectangle",
                "to_world": T().translate([0, 0, 0.1]).rotate([0, 1, 0], 180).scale([half, half, 1]),
                **self.diffuse(self.grey(0.7)),
            },
            lamp={
                "type": "rectangle",
                "to_world": T().translate([0, 0.3, -0.3]).rotate([1, 0, 0], -90).scale([0.12, 0.12, 1]),
                **self.emissive(self.grey(18.0)),
            },
            block={
                "type": "cube",
                "to_world": T().translate([-0.1, -0.1, -0.9]).rotate([0, 1, 0], 25).scale([0.05, 0.1, 0.05]),
                **self.diffuse({"type": "rgb", "value": [0.3, 0.4, 0.8]}),
            },
        )
