"""Licences that come along: those of installed packages, by their own metadata, against the page that names them."""

import re
from importlib import metadata

import pytest
from helpers.documentation import ROOT

OTHER = re.compile(r"\b(A|L)?GPL|Mozilla|\bMPL|EULA|Freeware|LicenseRef", re.IGNORECASE)
PAGE = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")


def asked_for(names: set[str]) -> set[str]:
    """Installed packages among these, and all that they ask for, without their extras."""
    found: set[str] = set()
    while names:
        name = names.pop()
        try:
            requirements = metadata.requires(name) or []
        except metadata.PackageNotFoundError:
            continue  # of another platform, or not installed here
        found.add(name)
        needed = {re.split(r"[\s\[<>=!~;(]", text)[0].lower() for text in requirements if "extra ==" not in text}
        names |= needed - found
    return found


def licence_of(name: str) -> str:
    """What a package says of its licence, in all the places for it; long texts by their first line."""
    entries = metadata.metadata(name)
    licence = (entries.get("License") or "").strip().split("\n")[0]
    classifiers = [text for text in entries.get_all("Classifier") or [] if text.startswith("License")]
    return " ".join([entries.get("License-Expression") or "", licence, *classifiers])


def test_every_licence_of_another_kind_is_named() -> None:
    """Packages that ours, its groups and its tests ask for, as far as they are installed."""
    asked = [re.split(r"[\s\[<>=!~;(]", text)[0].lower() for text in metadata.requires("lidarscene") or []]
    installed = asked_for({*asked, "asam-osi-utilities", "hypothesis", "tqdm"})
    assert len(installed) > 30
    others = {name for name in installed if OTHER.search(licence_of(name))}
    assert "ouster-sdk" in others or pytest.skip("ouster-sdk is not installed")
    assert {name for name in others if f"`{name}`" not in PAGE} == set()
