"""CITATION.cff names this version and the paper."""

from pathlib import Path

import yaml

import incremental_mapper

ROOT = Path(__file__).resolve().parents[2]


def test_the_citation_is_of_this_version_and_of_the_paper() -> None:
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert citation['version'] == incremental_mapper.__version__
    paper = citation['preferred-citation']
    assert paper['title'] in ' '.join((ROOT / 'README.md').read_text().split())
    assert [person['family-names'] for person in paper['authors']] == [
        'Griguletskii',
        'Belov',
        'Osinenko',
    ]
