"""The documentation as a site: it builds strictly, its equations are drawn, and it loads nothing from elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.browser import browser as browser
from helpers.child import assert_ended
from helpers.chromium import Chromium
from helpers.documentation import PAGES, ROOT, prose, text_of
from helpers.waiting import PATIENCE_S

EQUATION = re.compile(r"\$\$.+?\$\$", re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert_ended(built, stderr=None)
    return folder


def html(site: Path, page: Path) -> str:
    return text_of(site / page.with_suffix(".html").name)


@pytest.mark.parametrize("page", [page for page in PAGES if EQUATION.search(prose(page))], ids=lambda page: page.name)
def test_every_equation_is_drawn(site: Path, page: Path) -> None:
    """No LaTeX is left in what is drawn, and every number is an anchor."""
    drawn = re.findall(r"<math .*?</math>", html(site, page), re.DOTALL)
    assert len(drawn) == len(EQUATION.findall(prose(page)))
    assert not [equation for equation in drawn if "\\" in re.sub("<[^>]*>", "", equation)]
    for number in re.findall(r"\\tag\{(\w+)\}", text_of(page)):
        assert f'id="{number}"' in html(site, page)


def test_arguments_are_tables(site: Path) -> None:
    """Google's sections are read: names with their types, and the options of a class."""
    api = html(site, ROOT / "docs" / "api.md")
    tables = re.findall(r"<table>.*?</table>", api, re.DOTALL)
    for words in (("length_s", "float | None"), ("background_rays", "rays per pulse for the background")):
        texts = [" ".join(re.sub("<[^>]*>", "", table).split()) for table in tables]
        assert any(all(word in text for word in words) for text in texts), words


def test_numbers_link_to_their_equations(site: Path) -> None:
    assert 'href="theory.html#T2"' in html(site, ROOT / "docs" / "theory.md")
    assert 'href="theory_light.html#T35"' in html(site, ROOT / "docs" / "theory_light.md")
    assert 'href="sipm.html#T119"' in html(site, ROOT / "docs" / "theory.md")


def test_links_out_of_the_pages_lead_to_the_repository(site: Path) -> None:
    """The site has no other files: a path out of docs/ would lead nowhere."""
    links = [link for page in site.glob("*.html") for link in re.findall(r'href="?([^\s">]+)', text_of(page))]
    assert not [link for link in links if link.startswith("../")]
    assert [link for link in links if link.endswith("source/benchmarks/RESULTS.md#learning")]


def test_nothing_is_loaded_from_elsewhere(site: Path) -> None:
    """Scripts, styles, fonts and pictures are files of the site."""
    pages = list(site.glob("*.html"))
    assert len(pages) > 20
    for page in pages:
        loaded = re.findall(r"<(?:script|link|img|iframe)\b[^>]*?(?:src|href)=\"?([^\s\">]+)", text_of(page))
        assert loaded
        assert not [address for address in loaded if re.match(r"(https?:)?//", address)], page.name


def test_equations_have_no_scroll_bar(site: Path, browser: Chromium) -> None:
    """The window has 1280 pixels, and the page most equations: no bar, neither across nor beside."""
    browser.navigate((site / "theory.html").as_uri())
    browser.until("document.readyState === 'complete' && document.querySelectorAll('.equation').length > 10")
    barred = browser.value("""[...document.querySelectorAll('.equation')].filter(one =>
        one.scrollWidth > one.clientWidth
        || getComputedStyle(one).overflowY !== 'hidden' && one.scrollHeight > one.clientHeight
    ).map(one => one.textContent)""")
    assert barred == []


def test_the_site_is_searched_without_a_server(site: Path, browser: Chromium) -> None:
    """Its pages are opened as files, where browsers have no workers."""
    browser.navigate((site / "index.html").as_uri())
    browser.until("document.querySelector('.md-search__input').getBoundingClientRect().width > 100")
    left, top = browser.value(
        "(box => [box.x + 20, box.y + 10])(document.querySelector('.md-search__input').getBoundingClientRect())"
    )
    browser.click(left, top)
    browser.type("McIntyre")
    browser.until("document.querySelectorAll('.md-search-result__item a[href*=theory]').length > 0")
