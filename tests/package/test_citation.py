"""CITATION.cff agrees with the package and names the two studies. The paper's sources exist."""

from importlib import metadata

import yaml

from tiny_run import REPOSITORY


def test_the_citation_agrees_with_the_package():
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    package = metadata.metadata("evo-cpg")
    assert citation["cff-version"] == "1.2.0"
    # The citation names the newest release, which a version in development follows.
    assert "dev" in package["Version"] or citation["version"] == package["Version"]
    # The package has our licence and the licence of three.js.
    assert package["License-Expression"] == f"{citation['license']} AND MIT"
    assert [author["name"] for author in citation["authors"]] == [package["Author"]]
    assert ",".join(citation["keywords"]) == package["Keywords"]
    named = [(part["authors"][0]["family-names"], part["year"]) for part in citation["references"]]
    assert named == [("Iwadate", 2010), ("Fukui", 2003)]


def test_the_papers_sources_equal_its_list():
    folder = REPOSITORY / "docs" / "paper"
    text = (folder / "paper.md").read_text().split("---", 2)[2]
    named = {word.strip("[];.,:") for word in text.split() if word.strip("[").startswith("@")}
    listed = [
        line.partition("{")[2].rstrip(",")
        for line in (folder / "paper.bib").read_text().splitlines()
        if line.startswith("@")
    ]
    assert sorted(listed) == sorted(name.removeprefix("@") for name in named)
    assert 700 <= len(text.split()) <= 1000
