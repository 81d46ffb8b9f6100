"""What other libraries have for scenes and answers: gsplat's dictionaries of torch tensors, Open3D, pandas. Each is
imported when it is asked for.

Imports `scene`, `formats` and `query`.
"""
