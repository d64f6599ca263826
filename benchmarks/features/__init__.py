"""One small scene a feature that the exporter promises, and scenes of several features at random.

A feature's builder fills a `Stage` whose camera sits at (0, 0, 4), looks down, and sees 2.88 units across
z = 0. Surfaces are lit by an emitting panel beside the view and a dim world, which show in mirrors and
glass as well; lamps have scenes of their own.
"""

from . import at_random, camera, geometry, lights, materials, textures, world
from .at_random import random_scene
from .feature import BOUND, EVERYWHERE, Feature, box

__all__ = ["BOUND", "EVERYWHERE", "FEATURES", "Feature", "box", "random_scene"]

FEATURES = tuple(
    feature
    for group in (geometry, materials, textures, lights, world, camera, at_random)
    for feature in group.FEATURES
)
