"""`graph`: a segmenter without a download: small regions of similar colour, merged by a learned rule.

Source: Felzenszwalb and Huttenlocher 2004 for the regions; Nunez-Iglesias et al. 2013 for learning to merge from the
pairs that occur while merging.
"""

from .segmenter import GraphSegmenter

__all__ = ["GraphSegmenter"]
