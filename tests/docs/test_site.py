"""The documentation site: it builds without a warning, no link is broken, nothing comes
from the network, formulas are set."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[2]
BROWSER = shutil.which("chromium") or shutil.which("google-chrome")
LOADS = {
    "script": "src",
    "img": "src",
    "link": "href",
    "iframe": "src",
    "source": "src",
}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("material") is None, reason="needs the extra `docs`"
    ),
]


class Page(HTMLParser):
    """What a page loads and links to, its anchors, and its text outside of code."""

    def __init__(self, path):
        super().__init__()
        self.loads, self.links, self.anchors, self.text = [], [], set(), []
        self._inside = []
        self.feed(path.read_text())

    def handle_starttag(self, tag, attrs):
        given = {name: value or "" for name, value in attrs}
        self.anchors.update({given.get("id", ""), given.get("name", "")} - {""})
        if tag in ("pre", "code", "script", "style"):
            self._inside.append(tag)
        if "arithmatex" in given.get("class", "") or self.of_formula:
            self._inside.append(tag)
        if (loaded := given.get(LOADS.get(tag, ""))) and given.get(
            "rel"
        ) != "canonical":
            self.loads.append(loaded)
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])

    @property
    def of_formula(self):
        return any(tag in ("span", "div") for tag in self._inside)

    def handle_endtag(self, tag):
        if self._inside and self._inside[-1] == tag:
            self._inside.pop()

    def handle_data(self, data):
        if not self._inside:
            self.text.append(data)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    run = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr
    assert "WARNING" not in run.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


def test_links_and_pictures(site, pages):
    assert len(pages) > 40
    broken = []
    for path, page in pages.items():
        if path.name == "404.html":  # for servers, at any depth
            continue
        for link in (*page.links, *page.loads):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = path if not parts.path else path.parent / unquote(parts.path)
            target = target.resolve()
            if not target.is_file():
                broken.append((path.relative_to(site), link))
            elif parts.fragment and target.suffix == ".html":
                if unquote(parts.fragment) not in pages[target].anchors:
                    broken.append((path.relative_to(site), link))
    assert not broken


def test_nothing_comes_from_the_network(site, pages):
    for path, page in pages.items():
        away = [
            link for link in page.loads if urlsplit(link).scheme in ("http", "https")
        ]
        assert not away, path
        assert not re.search(r"import\(\s*[\"']https?:", path.read_text()), path
    for style in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import)\s*[\"']?https?:", style.read_text()), (
            style
        )


def test_formulas_are_marked(site, pages):
    """No dollar or TeX is left in the text, but in notebooks, whose formulas the browser
    finds by their dollars."""
    for path, page in pages.items():
        if "notebooks" not in path.parts:
            text = "".join(page.text)
            assert not re.search(r"\$[^$\n]*[\\^_][^$\n]*\$|\\\[|\\\(|\\frac", text), (
                path
            )


def dom(address, tmp_path):
    """The page after its scripts, and what they complained of."""
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    command += ["--enable-logging=stderr", "--virtual-time-budget=30000"]
    command += [f"--user-data-dir={tmp_path}", address]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    return run.stdout, [line for line in run.stderr.splitlines() if "CONSOLE" in line]


@pytest.mark.skipif(BROWSER is None, reason="needs a browser")
@pytest.mark.parametrize(
    "name", ["theory", "index", "api/fit", "notebooks/200_eells_energy"]
)
def test_formulas_are_set(name, site, tmp_path):
    text, complaints = dom((site / f"{name}.html").as_uri(), tmp_path)
    assert not complaints
    assert text.count("<mjx-container") >= (30 if name == "theory" else 3)
    assert "data-mjx-error" not in text and "mjx-merror" not in text
    assert not re.search(r'class="arithmatex">\s*\\[\[(]', text)


@pytest.mark.skipif(BROWSER is None, reason="needs a browser")
def test_search_works_from_files(site, tmp_path):
    text, complaints = dom((site / "index.html").as_uri() + "?q=reflections", tmp_path)
    assert not complaints
    assert re.search(r"[1-9]\d* matching documents", text)
    assert "faq.html" in text
