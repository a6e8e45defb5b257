"""What `mkdocs build` does beyond markdown: files of the repository become pages of the
site, and links between them lead to the same place on the site as on the forge."""

import re
from pathlib import Path
from posixpath import dirname, join, normpath, relpath

from mkdocs.plugins import event_priority
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
# Files outside of `docs` that are pages or pictures of the site, at the same paths
SHOWN = (
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "demo.png",
    "notebooks/*.ipynb",
    "benchmarks/results/*.md",
    "benchmarks/results/*.png",
)
LINK = re.compile(r"(\]\()([^)\s#:]+)(#[^)\s]*)?(?=\))")
TABLE = re.compile(r"^<!-- table (\d+) of (\S+) -->$", re.MULTILINE)


@event_priority(100)  # before the plugin for notebooks looks for them
def on_files(files, config):
    for pattern in SHOWN:
        for path in sorted(ROOT.glob(pattern)):
            name = path.relative_to(ROOT).as_posix()
            files.append(File(name, str(ROOT), config.site_dir, False))
    return files


def on_page_markdown(markdown, page, config, files):
    here = page.file.src_uri
    inside = (Path(config.docs_dir) / here).exists()
    source = join("docs", here) if inside else here

    def table(match):
        number, file = int(match[1]), ROOT / dirname(source) / match[2]
        shown = tables(file.read_text())[number - 1]
        return f'<div class="numbers" markdown>\n\n{shown}\n</div>'

    def link(match):
        path = normpath(join(dirname(source), match[2]))  # in the repository
        target = path.removeprefix("docs/")
        if files.get_file_from_path(target) is None:
            if not (ROOT / path).exists():
                return match[0]  # for mkdocs to complain about
            target = f"{config.repo_url}/blob/main/{path}"
        else:
            target = relpath(target, dirname(here) or ".")
        return match[1] + target + (match[3] or "")

    return LINK.sub(link, TABLE.sub(table, markdown))


def tables(markdown):
    """The tables of a text: runs of lines that start with a bar."""
    return re.findall(r"(?:^\|.*\n)+", markdown, re.MULTILINE)


def on_page_content(html, page, config, files):
    """Notebooks bring scripts from other hosts for formulas and diagrams; the formulas are
    set by the site's own, and there are no diagrams. And their links are not followed."""
    here = page.file.src_uri
    if not here.endswith(".ipynb"):
        return html

    def link(match):
        target = files.get_file_from_path(normpath(join(dirname(here), match[1])))
        return f'href="{target.url_relative_to(page.file)}"' if target else match[0]

    html = re.sub(r"<script[^>]*>.*?</script>", without_hosts, html, flags=re.DOTALL)
    return re.sub(r'href="([^":#]+)"', link, html)


def without_hosts(script):
    return "" if re.search(r"https?://|MathJax", script[0]) else script[0]
