"""The rules of ``checks``, asked of a sample: one line for each."""

from collections.abc import Iterator, Sequence

from incremental_mapper.checks.finding import Finding
from incremental_mapper.checks.gaps import silences
from incremental_mapper.config import Config
from incremental_mapper.datasets.remarks import Remarks
from incremental_mapper.datasets.sampling import SensorKind, SensorSample


def suspicions(samples: Sequence[SensorSample], config: Config) -> Iterator[Finding]:
    """Ask every rule that a sample can answer.

    Args:
        samples: what was read of each sensor.
        config: the settings in force.

    Yields:
        What is wrong, in no order.
    """
    remarks = Remarks()
    for sample in samples:
        for measurement in sample.measurements:
            remarks.take(measurement)
        if sample.kind is not SensorKind.GNSS:
            yield from silences(sample.sensor, sample.recorded)
    yield from remarks.findings()
