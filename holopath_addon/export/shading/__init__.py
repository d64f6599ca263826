"""What shader nodes mean: materials and textures, read where Mitsuba has them, and baked by Cycles where not."""
