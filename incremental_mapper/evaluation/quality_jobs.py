"""Comparing maps with the base map, as jobs that are not run again while the maps are the same."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from incremental_mapper.config import MomSettings
from incremental_mapper.evaluation import cache, map_quality
from incremental_mapper.evaluation.map_quality import MapQuality, compare_maps, read_map
from incremental_mapper.results.run_folder import FinishedRun

QUALITY_FILE = 'map_quality.json'


@dataclass(frozen=True, slots=True)
class QualityJob:
    """The folder of a finished run, and that of the base run of the same sequence, if any."""

    folder: Path
    base: Path | None


def stored_quality(job: QualityJob) -> MapQuality | None:
    """What an earlier call found; None where the maps or the comparison have changed since."""
    try:
        stored = json.loads((job.folder / QUALITY_FILE).read_text(encoding='utf-8'))
        return MapQuality(**stored['quality']) if stored['key'] == _key(job) else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def run_quality_job(job: QualityJob) -> MapQuality:
    """Compare the maps and store what was found; raises MapperError where one cannot be read."""
    settings = MomSettings.model_validate(FinishedRun(job.folder).stats['settings']['mom'])
    own = read_map(job.folder)
    base = None if job.base is None else own if job.base == job.folder else read_map(job.base)
    quality = compare_maps(own, base, settings)
    stored = {'key': _key(job), 'quality': asdict(quality)}
    cache.write_json(job.folder / QUALITY_FILE, stored)
    return quality


def _key(job: QualityJob) -> str:
    # The mark is written anew by every run, so its time tells of a run that was forced.
    marks = [folder and folder / cache.MARK for folder in (job.folder, job.base)]
    code = cache.code_fingerprint([Path(map_quality.__file__)])
    return cache.digest([*map(cache.file_fingerprint, marks), code])
