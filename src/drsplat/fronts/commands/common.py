"""Options that every verb has."""

import argparse

from .options import whole


def add_common(common: "argparse._ArgumentGroup") -> None:
    """Add --json, --threads, --config, --print-config, --log and --debug."""
    common.add_argument("--json", action="store_true", help="print one JSON object to stdout and nothing else there")
    common.add_argument(
        "--threads", type=whole, default=0, metavar="N",
        help="CPU threads; results are the same for any number (default: 0, all cores)",
    )  # fmt: skip
    common.add_argument(
        "--config", metavar="FILE", help="TOML file with options under [VERB]; the command line overrides it"
    )
    common.add_argument(
        "--print-config", action="store_true", help="print the options of this command as such a file, and exit"
    )
    common.add_argument("--log", metavar="FILE", help="append stderr to a file, with timestamps")
    common.add_argument("--debug", action="store_true", help="show the traceback of an error")
