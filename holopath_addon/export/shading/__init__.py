"""Materials and textures of shader nodes: read where Mitsuba has the same, otherwise baked by Cycles."""
