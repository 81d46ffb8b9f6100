"""What papers report of the systems that are measured here: other photos, other masks, another encoder."""

from .tables import markdown

COLUMNS = (
    "system", "LERF-OVS selection: mIoU", "Acc@0.25", "ScanNet localization: mIoU", "ScanNet 19 classes: mIoU",
    "ScanNet-200 localization: mIoU",
)  # fmt: skip
ROWS = (
    ("LangSplat-m", "9.8", "15.9", "8.0", "", "3.9"),
    ("LEGaussians-m", "", "", "9.5", "", "4.0"),
    ("OpenGaussian", "43.1", "59.6", "25.2", "30.1", "14.7"),
    ("Dr. Splat", "43.6", "63.9", "25.4", "29.6", "14.9"),
    ("Occam's LGS", "47.2", "74.8", "", "31.9", ""),
    ("VALA", "58.0", "82.9", "", "32.1", ""),
)
SOURCES = """\
The first four rows are of Dr. Splat's paper and its supplement (Table S3), with thresholds tuned on the test; the last
two, and their classes, of VALA's. These are other photos, masks and embeddings: compare the order of the systems, never
the numbers."""


def papers_table() -> str:
    return markdown(COLUMNS, ROWS)
