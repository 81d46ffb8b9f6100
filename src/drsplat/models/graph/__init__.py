"""`graph`: a segmenter without a network to download: small regions of like colour, merged by a learned rule.

Source: Felzenszwalb and Huttenlocher 2004 for the regions; Nunez-Iglesias et al. 2013 for learning the
merging from the pairs that are met while merging.
"""

from .segmenter import GraphSegmenter

__all__ = ["GraphSegmenter"]
