"""Named and versioned protocols: predict to disk, score from disk, report.

lerf_ovs, scannet_points, scannet_volume, voxel: one protocol each, with `predict` and `score`. running: `evaluate`, all
of it in one call. scorers: what they ask. metrics, thresholds, pseudo_labels: their algebra. report: JSON and HTML.

Imports `encoders`, `scene`, `formats`, `kernels`, `codes`, `field`, `drawing` and `query`.
"""
