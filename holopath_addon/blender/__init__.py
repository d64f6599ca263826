"""HoloPath in Blender: what is registered, the settings of a scene, the render engine, the viewport, demo scenes."""
