"""Fail if a page of a built site links to a file or an anchor of the site that is not there.

usage: python check_links.py FOLDER
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """targets: of links, pictures and scripts. anchors: that may be linked to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.targets.append(value)
            elif name in ("id", "name") and value:
                self.anchors.add(value)


def dead(site: Path) -> list[str]:
    """What leads nowhere, with the page that it is on. Addresses elsewhere are not asked."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if path.name != "404.html"}
    return [
        f"{path.relative_to(site)}: {target}"
        for path, page in pages.items()
        for target in page.targets
        if not _leads(target, path, pages)
    ]


def _leads(target: str, page: Path, pages: dict[Path, Page]) -> bool:
    address = urlsplit(target)
    if address.scheme or address.netloc:
        return True
    place = (page.parent / unquote(address.path)).resolve() if address.path else page
    place = place / "index.html" if place.is_dir() else place
    anchor = unquote(address.fragment)
    found = pages.get(place)
    return place.is_file() and (not anchor or found is None or anchor.startswith("__") or anchor in found.anchors)


def main(folder: str) -> int:
    site = Path(folder).resolve()
    found = dead(site)
    print("\n".join(found) or f"{sum(1 for _ in site.rglob('*.html'))} pages, every link leads somewhere")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
