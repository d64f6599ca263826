"""A first look at a scene, and how much of it has to be modelled."""
