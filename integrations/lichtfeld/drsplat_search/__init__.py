"""Plug-in for LichtFeld Studio: select Gaussians in words, asked of a running `drsplat serve`.

SPDX-License-Identifier: Apache-2.0
"""

import lichtfeld as lf

from .panel import SearchPanel


def on_load() -> None:
    lf.register_class(SearchPanel)


def on_unload() -> None:
    lf.unregister_class(SearchPanel)
