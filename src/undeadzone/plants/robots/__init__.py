"""Robot arms as plants: planar arms, an elastic joint, URDF files."""
