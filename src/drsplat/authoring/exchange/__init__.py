"""Scenes and answers for other libraries: gsplat's dictionaries of torch tensors, Open3D, pandas.

Each library is imported when it is needed.
"""
