"""Mitsuba's scene as the engine reads it: materials, lamps, rays and the chains of mirrors that they follow."""
