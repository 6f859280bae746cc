"""``epiprior-lab import SOURCE PATH --out FOLDER``, ``epiprior-lab check-set`` and ``epiprior-lab sets``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from epiprior_lab.pairsets import PairSet
    from epiprior_lab.pairsets.importers.output import FoundPair

app = typer.Typer(help="Make a pair set of published image pairs, or of your own photographs.", no_args_is_help=True)

PathArgument = Annotated[Path, typer.Argument(metavar="PATH", help="What was downloaded.", show_default=False)]
Out = Annotated[Path, typer.Option(help="Folder of the new pair set, such as data/real/NAME.", show_default=False)]
MaxSide = Annotated[int, typer.Option(min=64, help="Larger images are made smaller, pixels.")]
Images = Annotated[Path | None, typer.Option(help="Folder of the images, if it is not beside the rest.")]
Scene = Annotated[str | None, typer.Option(help="Name of the scene.")]
Origin = Annotated[
    float, typer.Option(help="Coordinate of the centre of the top-left pixel in the files: 1 where MATLAB counted.")
]
MinAngle = Annotated[float, typer.Option(help="Least angle between the rays to common points, degrees.")]
MaxAngle = Annotated[float, typer.Option(help="Largest angle between the rays to common points, degrees.")]
MinShared = Annotated[int, typer.Option(help="Least number of common points.")]
MaxPairs = Annotated[int, typer.Option(help="Most pairs per scene, taken evenly over the angles.")]


@app.command()
def colmap(
    path: PathArgument,
    out: Out,
    images: Images = None,
    scene: Scene = None,
    min_angle: MinAngle = 10.0,
    max_angle: MaxAngle = 70.0,
    min_shared: MinShared = 12,
    max_pairs: MaxPairs = 60,
    max_side: MaxSide = 1280,
) -> None:
    """COLMAP models: undistorted, pairs by viewing angle and common points, control points from tracks."""
    from epiprior_lab.pairsets.importers.colmap import find_colmap
    from epiprior_lab.pairsets.importers.structure import PairChoice

    choice = PairChoice(min_angle_deg=min_angle, max_angle_deg=max_angle, min_shared=min_shared, max_pairs=max_pairs)
    _import(out, max_side, lambda: find_colmap(path, images=images, scene=scene, choice=choice))


@app.command()
def strecha(
    path: PathArgument,
    out: Out,
    images: Images = None,
    min_angle: MinAngle = 10.0,
    max_angle: MaxAngle = 70.0,
    min_shared: MinShared = 12,
    max_pairs: MaxPairs = 60,
    max_side: MaxSide = 1280,
) -> None:
    """Strecha's multi-view sets: photographs with *.camera files."""
    from epiprior_lab.pairsets.importers.strecha import find_strecha
    from epiprior_lab.pairsets.importers.structure import PairChoice

    choice = PairChoice(min_angle_deg=min_angle, max_angle_deg=max_angle, min_shared=min_shared, max_pairs=max_pairs)
    _import(out, max_side, lambda: find_strecha(path, images=images, choice=choice))


@app.command()
def photos(
    path: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of photographs.", show_default=False)],
    out: Out,
    scene: Scene = None,
    min_angle: MinAngle = 10.0,
    max_angle: MaxAngle = 70.0,
    min_shared: MinShared = 12,
    max_pairs: MaxPairs = 60,
    max_side: MaxSide = 1280,
) -> None:
    """Your own photographs: structure from motion gives cameras, control points and pairs."""
    from epiprior_lab.pairsets.importers.photos import find_photos
    from epiprior_lab.pairsets.importers.structure import PairChoice

    choice = PairChoice(min_angle_deg=min_angle, max_angle_deg=max_angle, min_shared=min_shared, max_pairs=max_pairs)
    _import(out, max_side, lambda: find_photos(path, scene=scene, choice=choice))


def _match_files(name: str, text: str) -> None:
    @app.command(name, help=text)
    def command(path: PathArgument, out: Out, origin: Origin = 0.0, max_side: MaxSide = 1280) -> None:
        from epiprior_lab.pairsets.importers.match_files import find_match_files

        _import(out, max_side, lambda: find_match_files(name, path, origin=origin))


_match_files("kusvod2", "kusvod2 or homogr: nameA, nameB and name_vpts.mat, control points by hand.")
_match_files("adelaidermf", "AdelaideRMF: .mat files, or labelled text name_pts.txt beside nameA and nameB.")


def _sequences(name: str, text: str) -> None:
    @app.command(name, help=text)
    def command(path: PathArgument, out: Out, max_side: MaxSide = 1280) -> None:
        from epiprior_lab.pairsets.importers.sequences import find_sequences

        _import(out, max_side, lambda: find_sequences(name, path))


_sequences("oxford", "Oxford's affine covariant regions: folders with img1 to img6 and H1to2p to H1to6p.")
_sequences("hpatches", "HPatches sequences: folders with 1.ppm to 6.ppm and H_1_2 to H_1_6.")


@app.command()
def usac(
    path: PathArgument,
    out: Out,
    points: Annotated[Path | None, typer.Option(help="Folder of control points by hand, a file per pair.")] = None,
    max_side: MaxSide = 1280,
) -> None:
    """USAC release: folders with im1.jpg, im2.jpg and orig_pts.txt."""
    from epiprior_lab.pairsets.importers.pair_list import find_usac

    _import(out, max_side, lambda: find_usac(path, points=points))


@app.command()
def pairs(
    path: Annotated[Path, typer.Argument(metavar="TABLE", help="Table of pairs and their files.", show_default=False)],
    out: Out,
    images: Images = None,
    truths: Annotated[Path | None, typer.Option(help="Folder of the other files, if it is not the table's.")] = None,
    known: Annotated[str | None, typer.Option(help="Name of a known set, whose number of pairs is checked.")] = None,
    origin: Origin = 0.0,
    max_side: MaxSide = 1280,
) -> None:
    """List of pairs with control points, homographies or fundamental matrices as text."""
    from epiprior_lab.pairsets.importers.pair_list import find_pairs

    _import(out, max_side, lambda: find_pairs(path, images=images, truths=truths, origin=origin, known=known))


def check_set(folder: Annotated[Path, typer.Argument(help="Folder of a pair set.", show_default=False)]) -> None:
    """Read all of a pair set: tables, images, control points, depth maps, and whether they agree."""
    from epiprior_lab.pairsets import check_pair_set, read_pair_set
    from epiprior_lab.pairsets.importers.output import progress_bar

    with progress_bar("checking", len(read_pair_set(folder).pairs)) as advance:
        pair_set = check_pair_set(folder, on_pair=advance)
    kinds = sorted({pair.truth for pair in pair_set.pairs})
    typer.echo(f"{typer.format_filename(folder)}: {_counted(pair_set)}, truth: {', '.join(kinds)}")


def sets(folders: Annotated[list[Path], typer.Argument(help="Folders of pair sets, such as data/real.")]) -> None:
    """List the known pair sets, and which of them are present."""
    from rich.console import Console
    from rich.table import Table

    from epiprior_lab.pairsets import known_sets

    table = Table("set", "name", "pairs", "here")
    for known in known_sets():
        here = [str(folder / known.name) for folder in folders if known.present(folder)]
        table.add_row(known.title, known.name, str(known.pairs), ", ".join(here) or "not present")
    Console().print(table)


def register(lab: typer.Typer) -> None:
    """Add the commands of this module to ``epiprior-lab``."""
    lab.add_typer(app, name="import")
    lab.command("check-set")(check_set)
    lab.command()(sets)


def _import(out: Path, max_side: int, find: Callable[[], list[FoundPair]]) -> None:
    from epiprior_lab.pairsets.importers.output import check_out, write_found

    check_out(out)
    typer.echo(f"{typer.format_filename(out)}: {_counted(write_found(out, find(), max_side=max_side))}")


def _counted(pair_set: PairSet) -> str:
    numbers = {"pair": len(pair_set.pairs), "scene": len({pair.scene for pair in pair_set.pairs})}
    return " of ".join(f"{number} {noun}{'' if number == 1 else 's'}" for noun, number in numbers.items())
