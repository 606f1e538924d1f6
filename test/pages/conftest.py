"""The programs that make and check the pages are in docs/tools, which is no package."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'docs' / 'tools'))
