"""HoloPath in Blender: registration, settings of scenes, render engine, viewport and demo scenes."""
