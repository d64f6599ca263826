"""Texture type ``views``: radiance of a panel that depends on the viewpoint, as that of a light-field display.

A ray from the panel crosses the plane of the viewpoints, z = 0. The panel has the radiance of the views whose
viewpoints are around that place, interpolated between them; beyond the outermost viewpoints their views continue.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..buffers import gather_row, packed
from ..fingerprint import text_of_properties


class ViewTexture(mi.Texture):
    """Texture of a panel that shows views; (0, 0) of its uv is the top left corner of the middle viewpoint's view.

    Parameters
    ----------
    bitmap : mitsuba.Bitmap
        Linear RGB, float32: all views, one below the other, each row of viewpoints from the left to the right, the
        topmost row first.
    columns, rows : int
        Numbers of viewpoints.
    width, height : float
        Distances between the outermost viewpoints, meters; the grid's middle is at the origin.
    shift_x, shift_y : float
        Shift of a view's content to the right and down from the view before, fraction of a view; 0 if all views agree
        on the panel.
    """

    def __init__(self, props):
        super().__init__(props)
        texels = np.array(props["bitmap"])
        self._grid = props["columns"], props["rows"]
        extents = props["width"], props["height"]
        shifts = props["shift_x"], props["shift_y"]
        self._settings = text_of_properties(props)
        count = self._grid[0] * self._grid[1]
        self._shape = texels.shape[1], texels.shape[0] // count
        self._size = [dr.opaque(mi.UInt32, side) for side in self._shape]
        self._columns = dr.opaque(mi.UInt32, self._grid[0])
        # viewpoints to the right and down, per meter, and the number of the last one
        self._scale = [
            dr.opaque(mi.Float, (n - 1) / extent if n > 1 else 0.0)
            for n, extent in zip(self._grid, extents, strict=True)
        ]
        self._shift = [dr.opaque(mi.Float, shift) for shift in shifts]
        self._last = [dr.opaque(mi.UInt32, n - 1) for n in self._grid]
        self._texels = packed(np.ascontiguousarray(texels, np.float32).reshape(-1, 3))

    def _viewpoints(self, offset, axis):
        """Numbers of the viewpoints on both sides of an offset from the middle, meters, and their weights."""
        last = mi.Float(self._last[axis])
        place = dr.clip(offset * self._scale[axis] + 0.5 * last, 0, last)
        first = dr.clip(mi.Int32(dr.floor(place)), 0, mi.Int32(self._last[axis]))
        if self._grid[axis] == 1:
            return [(mi.UInt32(first), mi.Float(1))]
        weight = place - mi.Float(first)
        second = dr.minimum(first + 1, mi.Int32(self._last[axis]))
        return [(mi.UInt32(first), 1 - weight), (mi.UInt32(second), weight)]

    def _texel(self, coordinate, number, axis):
        """Column or row of a texture coordinate in a view, by its number; outside of 0 to 1 views are mirrored."""
        coordinate = coordinate + (mi.Float(number) - 0.5 * mi.Float(self._last[axis])) * self._shift[axis]
        coordinate = dr.abs(coordinate - 2 * dr.round(0.5 * coordinate))
        size = self._size[axis]
        return mi.UInt32(dr.clip(mi.Int32(coordinate * mi.Float(size)), 0, mi.Int32(size) - 1))

    def _color(self, si):
        towards = si.to_world(si.wi)
        # there is no direction when Mitsuba samples emitters
        way = dr.select(towards.z > 0, -si.p.z / towards.z, 0)
        across = self._viewpoints(si.p.x + way * towards.x, 0)
        down = self._viewpoints(-si.p.y - way * towards.y, 1)
        color = mi.Color3f(0)
        for v, weight_down in down:
            line = self._size[1] * v * self._columns + self._texel(si.uv.y, v, 1)
            for u, weight_across in across:
                place = (line + u * self._size[1]) * self._size[0] + self._texel(si.uv.x, u, 0)
                texel = gather_row(self._texels, place, 3)
                color += weight_down * weight_across * mi.Color3f(*texel)
        return color

    def eval(self, si, active=True):
        return dr.select(active, self._color(si), 0)

    def eval_3(self, si, active=True):
        return self.eval(si, active)

    def mean(self):
        return dr.mean(self._texels) * (4 / 3)  # each texel has a fourth number, which is 0

    def max(self):
        return float(dr.slice(dr.max(self._texels)))

    def resolution(self):
        return mi.ScalarVector2i(*self._shape)

    def is_spatially_varying(self):
        return True

    def traverse(self, callback):
        callback.put("texels", self._texels, mi.ParamFlags.NonDifferentiable)

    def to_string(self):
        return f"ViewTexture[{self._shape}, {self._settings}]"


mi.register_texture("views", ViewTexture)
