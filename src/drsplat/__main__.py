"""`python -m drsplat` is `drsplat`."""

from .cli import main

raise SystemExit(main())
