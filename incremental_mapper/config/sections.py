"""What all groups of settings are made of."""

from typing import Annotated, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from incremental_mapper.geometry import pose_matrix


def _check_transform(numbers: tuple[float, ...]) -> tuple[float, ...]:
    pose_matrix(numbers)  # raises ValueError where it is no rigid transform
    return numbers


Transform: TypeAlias = Annotated[tuple[float, ...], AfterValidator(_check_transform)]
Positive: TypeAlias = Annotated[float, Field(gt=0.0, le=1e6, allow_inf_nan=False)]
Sigma: TypeAlias = Annotated[float, Field(gt=0.0, le=1e4, allow_inf_nan=False)]


class Section(BaseModel):
    """A group of settings: frozen, and closed to unknown names."""

    model_config = ConfigDict(frozen=True, extra='forbid', use_attribute_docstrings=True)
