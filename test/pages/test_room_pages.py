"""The pages about files and rooms have all of them."""

import re

import room_pages

import incremental_mapper
from incremental_mapper.candidates import __doc__ as candidates_plate


def test_every_file_is_on_the_page_and_every_room_in_the_api() -> None:
    page = room_pages.files_page()
    api = room_pages.api_pages()
    files = [path for path in room_pages.PACKAGE.rglob('*.py') if not path.stem.startswith('__')]
    assert len(files) > 100
    for path in files:
        place = path.relative_to(room_pages.PACKAGE)
        name = '.'.join(['incremental_mapper', *place.with_suffix('').parts])
        room = place.parts[0] if len(place.parts) > 1 else room_pages.GROUND
        assert f'::: {name}\n' in api[f'api/{room}.md']
        within = place.relative_to(room) if room != room_pages.GROUND else place
        section = page.split(f'{{#{room}}}')[1].split('\n## ')[0]
        assert f'| `{within}` | ' in section


def test_a_file_is_told_by_its_first_line_and_a_room_by_its_door_plate() -> None:
    page = room_pages.files_page()
    assert (
        '| `partitions.py` | Merging adjacent core measurements into clusters (paper, '
        'Algorithm 1, steps 2 and 3). |'
    ) in page
    assert candidates_plate is not None
    assert candidates_plate.strip() in page
    assert candidates_plate.strip() in room_pages.api_pages()['api/candidates.md']


def test_the_titles_are_the_pages() -> None:
    assert room_pages.titles().keys() == room_pages.api_pages().keys()


def test_the_front_door_has_all_that_it_offers() -> None:
    page = (room_pages.PACKAGE.parent / 'docs' / 'api' / 'index.md').read_text()
    shown = re.findall(r'^::: incremental_mapper\.(\w+)$', page, re.M)
    assert sorted(shown) == sorted(set(incremental_mapper.__all__) - {'__version__'})
