"""drsplat: search a 3D Gaussian Splatting scene in words."""
