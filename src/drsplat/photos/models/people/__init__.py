"""People in photos: where they are, and masks that leave them out.

Begin with `leaving_out.py`. The weights are those of a DeepLabv3 that Google's Coral team published (Apache-2.0, see
`LICENSE` and `NOTICE` here), and run natively.
"""

from .finding import people
from .leaving_out import without_people

__all__ = ["people", "without_people"]
