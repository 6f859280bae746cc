"""``epiprior-lab label``: control points by hand for one pair of images."""

import threading
import webbrowser
from pathlib import Path
from typing import Annotated

import typer


def label(
    image1: Annotated[Path, typer.Argument(metavar="A", help="First image.", show_default=False)],
    image2: Annotated[Path, typer.Argument(metavar="B", help="Second image.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(help="File of control points; continued where it exists.", show_default="A-B.csv in this folder"),
    ] = None,
    port: Annotated[int, typer.Option(help="Port on 127.0.0.1; 0 takes a free one.")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Start anew over another pair's or a damaged file.")] = False,
) -> None:
    """Click control points of one pair in the browser: the same point in both images, saved as x1,y1,x2,y2."""
    from epiprior_lab.labels.by_hand.server import LabelServer
    from epiprior_lab.labels.by_hand.session import LabelSession

    out = out or Path(f"{image1.stem}-{image2.stem}.csv")
    session = LabelSession(image1, image2, out, force=force)
    known, file = session.count(), typer.format_filename(out)
    place = typer.format_filename(out.absolute())
    typer.echo(f"{file}: continues {_points(known)}" if known else f"Points are saved to {place}")
    with LabelServer(session, port) as server:
        typer.echo(f"Label at {server.url}")
        typer.echo("End with the page's Done, or Ctrl+C here (what the page did not save is lost).")
        if browser:
            # In a thread: a browser in the terminal would block this one, which answers it.
            threading.Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        try:
            server.serve()
        except KeyboardInterrupt:
            typer.echo()
    count = session.count()
    typer.echo(f"{file}: nothing was saved" if count is None else f"{file}: {_points(count)}")


def _points(count: int) -> str:
    return "1 point" if count == 1 else f"{count} points"
