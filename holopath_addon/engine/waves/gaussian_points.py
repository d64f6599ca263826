"""Quadrature points (x, y, z, weight) of a three-dimensional Gaussian, in its standard deviations.

Means of polynomials over the points are those over the Gaussian up to a degree (Stroud, Approximate Calculation of
Multiple Integrals, 1971, section 8.8). The points of the fifth and the seventh degree start with the center.
"""

import itertools
import math


def _symmetric(point, weight):
    """Points with the same coordinates in any order and of any sign."""
    places = set()
    for signs in itertools.product((1, -1), repeat=3):
        places.update(itertools.permutations(s * value + 0.0 for s, value in zip(signs, point, strict=True)))
    return [(*place, weight) for place in sorted(places)]


def _fifth():
    """13 points: the center and the corners of an icosahedron."""
    ring = [(2 * math.cos(a), 2 * math.sin(a), 1.0) for a in (n * (2 * math.pi / 5) for n in range(5))]
    corners = [(0.0, 0.0, math.sqrt(5)), *ring]
    points = [(sign * x, sign * y, sign * z, 1 / 20) for x, y, z in corners for sign in (1, -1)]
    return ((0.0, 0.0, 0.0, 2 / 5), *points)


def _seventh():
    """27 points: the center, and points on axes, face diagonals and corners of cubes of squares 1/a, 1/b and 1/c.

    Moments x^2 y^2 z^2, x^4 y^2 and x^6 give the weights; x^2 y^2, x^4 and x^2 give c = 1 - 2 b, a = (1 - b) / 5 and
    10 a^2 + 4 b^2 + c^2 = 1.
    """
    b = (4.8 - math.sqrt(9.6)) / 16.8
    a, c = (1 - b) / 5, 1 - 2 * b
    points = _symmetric((a**-0.5, 0, 0), 5 * a**3) + _symmetric((b**-0.5, b**-0.5, 0), b**3 / 2)
    points += _symmetric((c**-0.5,) * 3, c**3 / 8)
    return ((0.0, 0.0, 0.0, 1 - sum(point[3] for point in points)), *points)


THIRD = tuple(_symmetric((math.sqrt(3), 0, 0), 1 / 6))
FIFTH, SEVENTH = _fifth(), _seventh()
