"""The parameters of the benchmark of collections: one strict schema over ``benchmarks/sfm/params.yaml``.

As in `epiprior_lab.params`, every key must be there, of its type and in its range; there are no defaults.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from epiprior_lab.params import STRICT, Count, Listed, Seed, Share, read_checked

PATH = Path("benchmarks/sfm/params.yaml")

Degrees = Annotated[float, Field(ge=0.1, le=180)]
Size = Annotated[int, Field(ge=2, le=1000)]
Filled = Literal["colmap", "snn", "cascade", "preprocess"]
Learned = Literal["aliked", "disk", "xfeat"]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BagParams:
    """Sets over whose pairs bags grow: so many of each size per scene.

    The first bag of size `stranger_size` of every scene comes again with one photograph of another set.
    """

    seed: Seed
    groups: Listed[str]
    per_scene: Mapping[Size, Count]
    stranger_size: Size

    def __post_init__(self) -> None:
        if self.stranger_size not in self.per_scene:
            raise ValueError(f"stranger_size = {self.stranger_size}: not among the sizes of per_scene")


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TwinParams:
    """Rendered twins: for each of `styles` two houses, each with `pairs` pairs of photographs."""

    seed: Seed
    family: str
    styles: Count
    pairs: Count
    jpeg_quality: Annotated[int, Field(ge=1, le=100)]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MethodParams:
    """What fills the database; `learned` matchers do it on bags of `learned_kinds`, plain ones of `learned_sizes`."""

    names: Listed[Filled]
    learned: Listed[Learned] | None
    learned_kinds: Listed[Literal["plain", "stranger", "twins"]]
    learned_sizes: Listed[Size]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class MapperParams:
    """How every database is mapped, and when what comes out is right.

    Geometries of epiprior count from `min_confidence`. A registered photograph is wrong where its median error to the
    others is above `wrong_deg`; accuracy is the mean, over `accuracy_deg`, of the share of pairs below.
    """

    seed: Seed
    min_confidence: Share
    wrong_deg: Degrees
    accuracy_deg: Listed[Degrees]


@dataclass(frozen=True, kw_only=True, config=STRICT)
class BagReportParams:
    """Totals are over bags of `sizes`; every method is compared with `against`; shares of right X_L make a bag hard."""

    seed: Seed
    bootstrap_draws: Annotated[int, Field(ge=100, le=1_000_000)]
    against: Filled
    sizes: Listed[Size]
    easy_share: Share
    hard_share: Share


@dataclass(frozen=True, kw_only=True, config=STRICT)
class SfmParams:
    """All sections."""

    bags: BagParams
    twins: TwinParams
    methods: MethodParams
    mapper: MapperParams
    report: BagReportParams

    def __post_init__(self) -> None:
        for key, sizes in (("report.sizes", self.report.sizes), ("learned_sizes", self.methods.learned_sizes)):
            if unknown := sorted(set(sizes) - set(self.bags.per_scene)):
                raise ValueError(f"{key}: {unknown[0]} is not among the sizes of bags.per_scene")
        if self.report.against not in self.methods.names:
            raise ValueError(f"report.against: {self.report.against!r} is not among methods.names")


def load_sfm_params(path: Path | str = PATH) -> SfmParams:
    """Read and check the parameter file; a SettingsError names the file and what is wrong in it."""
    return read_checked(path, lambda _: SfmParams)
