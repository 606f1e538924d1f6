"""Pages of templates and their one style, in a file of their own.

Importing this needs jinja2, which comes with the extra ``report``.
"""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FunctionLoader, StrictUndefined

from incremental_mapper.errors import OutputError
from incremental_mapper.visualization.figure import DARK, LIGHT, css_variables

FILE_NAME = 'report.html'
STYLE = 'style.css'


def write_page(folder: Path, template: str, context: Mapping[str, Any]) -> Path:
    """Fill a template and write ``report.html``; returns its path.

    Args:
        folder: Where to.
        template: Its name beside this file.
        context: What it is filled with; style and colours come on top.

    Raises:
        OutputError: The page cannot be written.
    """
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=FunctionLoader(_resource),
    )  # fmt: skip
    page = environment.get_template(template).render(
        context, style=_resource(STYLE), light=css_variables(LIGHT), dark=css_variables(DARK)
    )
    path = folder / FILE_NAME
    partial = path.with_name(f'.{path.name}.partial')
    try:
        partial.write_text(page, encoding='utf-8')
        partial.replace(path)
    except OSError as error:
        raise OutputError(f'{path}: cannot be written ({error.strerror})') from error
    return path


def as_yaml(tree: Mapping[str, Any]) -> str:
    """Settings as people write them."""
    return yaml.safe_dump(dict(tree), sort_keys=False, default_flow_style=None, width=100).strip()


def _resource(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding='utf-8')
