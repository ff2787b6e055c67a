"""Robot arms as plants: planar ones, an elastic joint, URDF files."""
