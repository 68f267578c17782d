#!/usr/bin/env python3
"""Puts what the book's pages name outside docs/ beside the book: site.py BOOK. It needs markdown2, which pdoc brings.

Links of the built pages that leave docs/ are turned to copies in BOOK/repository: Markdown as pages, other text as it is,
folders as lists. Links of these copies are treated alike."""

import html
import posixpath
import re
import sys
from pathlib import Path
from urllib.parse import unquote

import markdown2

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r'(<(?:a|img)\b[^>]*?\b(?:href|src)=")([^"#:]+)((?:#[^"]*)?")')
PAGE = """<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title><style>
:root {{ color-scheme: light dark; }}
body {{ font: 16px/1.6 sans-serif; max-width: 60rem; margin: 0 auto; padding: 1rem; overflow-wrap: break-word; }}
pre, table {{ overflow-x: auto; display: block; }} pre {{ padding: .8rem; border: 1px solid #8886; font-size: 14px; }}
th, td {{ border: 1px solid #8886; padding: .2rem .6rem; }} table {{ border-collapse: collapse; }} img {{ max-width: 100%; }}
</style></head><body><p><a href="{home}">RenderFlow</a> / {title}</p>
{body}</body></html>
"""
EXTRAS = ["tables", "fenced-code-blocks", "header-ids", "cuddled-lists"]


class Site:
    def __init__(self, book):
        self.book, self.made = book, set()

    def address(self, path):
        """The page in the book, from its root, that shows a file or folder of the repository; `None` where there is none."""
        inside = posixpath.relpath(path, "docs")
        page = re.sub(r"\.md$", ".html", inside)
        if not inside.startswith("..") and (self.book / page).is_file():
            return page
        source = ROOT / path
        if not source.exists() and path.endswith(".html"):
            path = path[:-5] + ".md"
            source = ROOT / path
        if path.startswith("..") or not source.exists():
            return None
        if source.suffix in (".png", ".jpg", ".gif", ".svg"):
            out = "repository/" + path
            (self.book / out).parent.mkdir(parents=True, exist_ok=True)
            (self.book / out).write_bytes(source.read_bytes())
            return out
        out = (
            "repository/"
            + ("" if path == "." else path + "/" if source.is_dir() else path + ".")
            + ("index.html" if source.is_dir() else "html")
        )
        if out not in self.made:
            self.made.add(out)
            self.copy(source, path, out)
        return out

    def copy(self, source, path, out):
        if source.is_dir():
            # One level: folders in folders are named, not copied.
            rows = []
            for entry in sorted(source.iterdir()):
                if entry.name.startswith(".") or entry.name in ("target", "__pycache__"):
                    continue
                if (
                    entry.is_file()
                    and entry.suffix in (".md", ".rs", ".py", ".json", ".toml", ".sh", ".ipynb")
                    and entry.stat().st_size < 200_000
                ):
                    rows.append(f'<li><a href="{entry.name}">{entry.name}</a></li>')
                else:
                    rows.append(f"<li>{entry.name}{'/' if entry.is_dir() else ''}</li>")
            body, base = "<ul>" + "".join(rows) + "</ul>", path
        elif source.suffix == ".md":
            body, base = markdown2.markdown(source.read_text(encoding="utf-8"), extras=EXTRAS), posixpath.dirname(path)
        else:
            body, base = f"<pre>{html.escape(source.read_text(encoding='utf-8'))}</pre>", None
        target = self.book / out
        target.parent.mkdir(parents=True, exist_ok=True)
        if base is not None:
            body = self.turned(body, base, out)
        home = posixpath.relpath("index.html", posixpath.dirname(out))
        target.write_text(PAGE.format(title=html.escape(path), home=home, body=body), encoding="utf-8")

    def turned(self, text, base, page):
        """The text with its links turned to pages of the book. They start from the folder `base` of the repository."""

        def turn(found):
            goal = posixpath.normpath(posixpath.join(base, unquote(found[2])))
            address = self.address(goal)
            return found[0] if address is None else found[1] + posixpath.relpath(address, posixpath.dirname(page)) + found[3]

        return LINK.sub(turn, text)

    def page(self, path):
        name = path.relative_to(self.book).as_posix()
        text = path.read_text(encoding="utf-8")

        def leaving(found):
            goal = posixpath.normpath(posixpath.join(posixpath.dirname(name), found[2]))
            outside = goal.startswith("..") or (self.book / goal).is_dir() and not (self.book / goal / "index.html").exists()
            if not outside or found[2].startswith("/"):
                return found[0]
            return self.turned(found[0], posixpath.join("docs", posixpath.dirname(name)), name)

        path.write_text(LINK.sub(leaving, text), encoding="utf-8")


def main(book):
    site = Site(Path(book))
    for path in sorted(site.book.rglob("*.html")):
        if path.relative_to(site.book).parts[0] not in ("api", "repository"):
            site.page(path)
    print(f"{len(site.made)} files and folders of the repository stand beside the book")


if __name__ == "__main__":
    main(*sys.argv[1:])
