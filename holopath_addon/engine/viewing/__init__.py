"""Views of a field and of the scene itself, and measures of how far they differ."""
