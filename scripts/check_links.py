#!/usr/bin/env python3
"""Follows every internal link of a built site: check_links.py FOLDER [--skip PATTERN]. It exits with 1 where one leads
nowhere.

Links are those of `a`, `link`, `img`, `script`, `source` and `iframe`. A fragment must be the id or the name of an element of
its page. Links to other sites are not followed. Pages that match PATTERN are not read, but links may lead to them."""

import argparse
import fnmatch
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

ATTRIBUTES = {"a": "href", "link": "href", "img": "src", "script": "src", "source": "src", "iframe": "src"}


class Page(HTMLParser):
    """The links and the anchors of one page."""

    def __init__(self, path):
        super().__init__()
        self.links, self.anchors = [], set()
        self.feed(path.read_text(encoding="utf-8", errors="replace"))

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        self.anchors |= {attributes[name] for name in ("id", "name") if attributes.get(name)}
        target = attributes.get(ATTRIBUTES.get(tag))
        if target:
            self.links.append((self.getpos()[0], target))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--skip", action="append", default=[], help="pages not to read, such as api/rust/src/*")
    options = parser.parse_args()
    root = options.folder.resolve()
    pages, faults, followed, read = {}, [], 0, 0

    def page(path):
        if path not in pages:
            pages[path] = Page(path)
        return pages[path]

    for path in sorted(root.rglob("*.html")):
        name = path.relative_to(root).as_posix()
        if any(fnmatch.fnmatch(name, pattern) for pattern in options.skip):
            continue
        read += 1
        for line, target in page(path).links:
            parts = urlsplit(target)
            if parts.scheme or parts.netloc:
                continue
            followed += 1
            # 404.html stands for pages of any depth, so its links start at the root of the site.
            start = root if parts.path.startswith("/") or name == "404.html" else path.parent
            goal = path if not parts.path else (start / unquote(parts.path).lstrip("/")).resolve()
            if goal.is_dir():
                goal = goal / "index.html"
            if not goal.is_file():
                faults.append(f"{name}:{line}: {target}: there is no such page")
            elif parts.fragment and goal.suffix == ".html" and not {parts.fragment, unquote(parts.fragment)} & page(goal).anchors:
                # Rustdoc marks lines of sources in its script.
                if not ("/src/" in goal.as_posix() and parts.fragment.replace("-", "").isdigit()):
                    faults.append(f"{name}:{line}: {target}: the page has no such place")
    print(*faults, sep="\n", end="\n" if faults else "")
    print(f"{read} pages, {followed} internal links, {len(faults)} lead nowhere")
    sys.exit(bool(faults) or not read)


if __name__ == "__main__":
    main()
