"""What Blender and the command line share: a hologram with its pictures, its folder, and what is said of both."""
