"""What mkdocs runs while it builds the site: generated pages, equations, and the font for them."""

from pathlib import Path
from typing import Any

import equations
import room_pages
import settings_page
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[2]
DEVELOPMENT = {
    'development/contributing.md': 'CONTRIBUTING.md',
    'development/changelog.md': 'CHANGELOG.md',
}
"""Pages that are files of the repository's root."""
LINKS = {f']({name})': f']({place.rpartition("/")[2]})' for place, name in DEVELOPMENT.items()}
LINKS['](docs/'] = '](../'


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made from code: settings, rooms, files; and those from the root."""
    pages = {'configuration.md': settings_page.page(), 'code/files.md': room_pages.files_page()}
    pages |= room_pages.api_pages()
    for place, name in DEVELOPMENT.items():
        text = (ROOT / name).read_text(encoding='utf-8')
        for there, here in LINKS.items():
            text = text.replace(there, here)
        pages[place] = text
    for place, text in pages.items():
        files.append(File.generated(config, place, content=text))
    return files


def on_config(config: Any) -> Any:
    """Add the rooms to the part of the navigation that shows the API."""
    for entry in config['nav']:
        for parts in entry.values():
            for part in parts if isinstance(parts, list) else ():
                if isinstance(part.get('API'), list):
                    part['API'] += [{name: place} for place, name in room_pages.titles().items()]
    return config


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Turn equations into MathML; a wrong one ends the build."""
    try:
        return equations.with_equations(html)
    except equations.MathError as error:
        raise SystemExit(f'{page.file.src_uri}: {error}') from error


def on_post_build(config: Any) -> None:
    """Put the font of the equations beside the style sheet."""
    equations.write_font(Path(config['site_dir']) / 'assets' / 'STIXTwoMath.woff')
