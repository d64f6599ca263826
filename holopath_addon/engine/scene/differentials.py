"""Ray differentials along a chain of mirrors and lenses, and where neighboring rays cross (stage s6)."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

# without the UV flag Mitsuba derives position and normal by the same parameters
SHAPE_FLAGS = mi.RayFlags.ShadingFrame | mi.RayFlags.dNSdUV


def start(ray: mi.Ray3f) -> list:
    """Differentials of a ray's point and unit direction for two shifts of its origin and two turns: four pairs."""
    none = mi.Vector3f(0)
    axes = [mi.Vector3f(axis) for axis in mi.coordinate_system(ray.d)]
    return [(axis, none) for axis in axes] + [(none, axis) for axis in axes]


def after_hit(
    moves: list,
    ray: mi.Ray3f,
    surface: mi.PreliminaryIntersection3f,
    ahead: mi.Float,
    reflected: mi.Bool,
    eta: mi.Float,
    active: mi.Bool,
) -> list:
    """Propagate differentials to a surface, and reflect or refract them.

    H. Igehy, Tracing Ray Differentials, SIGGRAPH 1999: no neighboring rays are traced.

    Parameters
    ----------
    moves : list
        Differentials, see `start`.
    ray : mitsuba.Ray3f
    surface : mitsuba.PreliminaryIntersection3f
    ahead : mitsuba.Float
        Distance from the segment's true origin at which the ray starts.
    reflected : mitsuba.Bool
        Whether the ray is reflected, or refracted.
    eta : mitsuba.Float
        Relative index of refraction.
    active : mitsuba.Bool
    """
    si = surface.compute_surface_interaction(ray, SHAPE_FLAGS, active)
    n = mi.Vector3f(si.sh_frame.n)
    cosine = dr.dot(ray.d, n)
    # law of refraction with the normal against the ray: D' = ratio D - mu N
    side = dr.select(cosine < 0, mi.Float(1), mi.Float(-1))
    ratio = dr.rcp(eta)
    inner = side * cosine
    outer = -dr.safe_sqrt(1 - ratio**2 * (1 - inner**2))
    mu = ratio * inner - outer
    guu, guv, gvv = dr.squared_norm(si.dp_du), dr.dot(si.dp_du, si.dp_dv), dr.squared_norm(si.dp_dv)
    scale = guu * gvv - guv * guv
    scale = dr.select(scale > 0, dr.rcp(scale), 0)
    after = []
    for point, turn in moves:
        point = point + (si.t + ahead) * turn
        point -= dr.dot(point, si.n) / dr.dot(ray.d, si.n) * ray.d
        u, v = dr.dot(point, si.dp_du), dr.dot(point, si.dp_dv)
        dn = scale * ((gvv * u - guv * v) * si.dn_du + (guu * v - guv * u) * si.dn_dv)
        tilt = dr.dot(turn, n) + dr.dot(ray.d, dn)
        mirrored = turn - 2 * (tilt * n + cosine * dn)
        bent = ratio * turn - side * (mu * dn) - (ratio - ratio**2 * inner / outer) * tilt * n
        after.append((point, dr.select(reflected, mirrored, bent)))
    return after


def crossing(moves: list, last: mi.Ray3f, reach: mi.Float) -> mi.Float:
    """Distance along the first segment of a chain where rays from the same real point P cross.

    With dP = A dO + B dv, the move of P under a shift dO of the origin and a turn dv of the direction, rays through the
    same P have dv = -B^-1 A dO; they cross the first at distance t = 2 / trace(B^-1 A), the inverse of the mean of the
    two focal distances' inverses. Without mirrors A = 1, B = t.

    Parameters
    ----------
    moves : list
        Differentials, see `start`.
    last : mitsuba.Ray3f
        Last segment.
    reach : mitsuba.Float
        Distance of P on it.
    """
    across, along = mi.coordinate_system(last.d)
    landings = [point + reach * turn for point, turn in moves]
    (a11, a21), (a12, a22), (b11, b21), (b12, b22) = (
        (dr.dot(landing, across), dr.dot(landing, along)) for landing in landings
    )
    determinant = b11 * b22 - b12 * b21
    trace = b22 * a11 - b12 * a21 + b11 * a22 - b21 * a12
    return dr.select(trace != 0, 2 * determinant / trace, dr.inf)
