"""Named and versioned protocols: predict to disk, score from disk, report.

lerf_ovs, scannet_points, scannet_volume, voxel: one protocol each, with `predict` and `score`. running: `evaluate`, all
of it in one call. scorers: methods that are scored. metrics, thresholds, pseudo_labels: the algebra. report: JSON and
HTML.

Imports `encoders`, `scene`, `formats`, `kernels`, `codes`, `field`, `drawing` and `query`.
"""
