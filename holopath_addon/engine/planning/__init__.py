"""Planning: the survey of a scene, and all decisions on how it is rendered."""
