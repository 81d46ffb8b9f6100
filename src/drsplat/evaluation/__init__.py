"""Named and versioned protocols: predict to disk, score from disk, report; and the demo, which is scored likewise.

lerf_ovs, scannet_points, scannet_volume, voxel: one protocol each, with `predict` and `score`. running: `evaluate`, all
of it in one call. scorers: methods that are scored. metrics, thresholds, pseudo_labels: the algebra. report: JSON and
HTML. Begin with `running`.

Imports `scene`, `formats`, `kernels`, `field`, `photos`, `drawing` and `query`.
"""
